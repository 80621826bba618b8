// A loop over independent items on several threads. Which thread does which item is not determined;
// results that must be, are written to slot `index` and reduced in order afterwards.
#pragma once

#include <functional>

namespace rg::sysid {

// Calls body(worker, index) once for every index in [0, count), worker in [0, threads). Returns when all
// are done. body must not throw. threads ≤ 1: on the caller's thread, in order.
void ParallelFor(int threads, int count, const std::function<void(int worker, int index)>& body);

// `wanted`, or the machine's number of hardware threads when it is 0.
int ChooseThreads(int wanted);

}  // namespace rg::sysid

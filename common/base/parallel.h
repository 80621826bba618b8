// A loop over independent items on the threads of a pool that the process has once. Which thread does which
// item is not determined; results that must be, are written to slot `index` and reduced in order afterwards.
#pragma once

#include <functional>

namespace rg {

// Calls body(worker, index) once for every index in [0, count), worker in [0, threads), never two at a time
// with one worker's number. Returns when all are done. threads ≤ 1: on the caller's thread, in order.
//
// The caller is worker 0 and does what no other thread comes for: threads of the pool that are busy, with a
// loop around this one or another thread's, are not waited for. So loops may be nested and begun on any
// thread, but a body must not wait for another item's. The pool has as many threads as the widest loop so far
// needed.
//
// What body throws ends the loop: no further item is begun, and when all that were have ended, the exception
// of the least index is thrown here, whatever the number of threads.
void ParallelFor(int threads, int count, const std::function<void(int worker, int index)>& body);

// `wanted`, or the machine's number of hardware threads when it is 0.
int ChooseThreads(int wanted);

}  // namespace rg

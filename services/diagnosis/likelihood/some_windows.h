// Which windows stand for all of them where a fit or a screen need not be exact.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rg::diagnosis {

// The places of so many windows, or of all, evenly spread.
std::vector<uint32_t> EvenlySpread(size_t windows, size_t count);

// The places of so many windows, the first of every recording before the second of any. recordings: that each
// window belongs to, in the order of time within each.
std::vector<uint32_t> FirstOfEach(const std::vector<int>& recordings, size_t count);

// The windows, about `wanted` of `all`, on which trials are fitted: every so many. Where these hold less than
// half of what is amiss (χ² of each window beyond noise: a joint that saturates in three of sixty), every so
// much of what is amiss and of the windows, in equal parts.
std::vector<uint32_t> SomeWindows(const std::vector<double>& amiss, size_t all, size_t wanted);

}  // namespace rg::diagnosis

// The few statistics of examinations.
#pragma once

#include <vector>

namespace rg::proof {

// A share with its 95 % interval (Wilson 1927). No case: NaN, from 0 to 1.
struct Share {
  double value = 0, low = 0, high = 1;
  int n = 0;
};
Share ShareOf(double hits, int n);

double Mean(const std::vector<double>& values);  // of none: NaN
double Median(std::vector<double> values);       // of none: NaN

// McNemar's test, exact and two-sided: the probability that two equally good methods, of `won + lost` cases
// on which they differ, differ as unevenly or more. Of none: 1.
double McNemarExact(int won, int lost);

}  // namespace rg::proof

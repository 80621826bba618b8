// Log of a search on stderr, one line per fit and decision, if RG_DIAGNOSIS_TRACE is set.
#pragma once

#include <string>

#include "common/base/clock.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/screening/screening.h"

namespace rg::diagnosis {

class Trace {
 public:
  explicit Trace(const Clock& clock);

  void Stage(const std::string& stage, const std::string& note) const;
  void Fit(const Candidate& c, const char* what) const;
  void Screen(const ScreenResult& s, bool base) const;
  double Elapsed() const { return clock_.SteadySeconds() - start_; }  // s

 private:
  const Clock& clock_;
  double start_;
  bool on_;
};

}  // namespace rg::diagnosis

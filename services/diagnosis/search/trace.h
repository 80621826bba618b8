// What a search tries, line by line on stderr, where RG_DIAGNOSIS_TRACE is set: for whoever asks why a
// diagnosis says what it says.
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

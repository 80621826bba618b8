// A recording set made ready for fits and screens.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis::testing {

struct Prepared {
  recordings::RecordingSet set;
  sim::Plant nominal;
  FitData data;
  MotionScales scales;
  DiagnosisOptions options;
};

inline std::unique_ptr<Prepared> Prepare(recordings::RecordingSet set) {
  auto nominal = sysid::NominalPlant(set);
  RG_CHECK(nominal.ok()) << nominal.status().ToString();
  auto out = std::make_unique<Prepared>(Prepared{std::move(set), *nominal, {}, {}, {}});
  auto data = PrepareData(out->set, out->nominal, out->options);
  RG_CHECK(data.ok()) << data.status().ToString();
  out->data = *data;
  out->scales = ScalesOf(out->data, out->nominal);
  return out;
}

inline std::unique_ptr<Prepared> Prepare(const std::string& robot, std::vector<effects::EffectSpec> effects,
                                         uint64_t seed, const Sampling& sampling = {}) {
  return Prepare(MakeSet(robot, std::move(effects), seed, 4.0, sampling));
}

}  // namespace rg::diagnosis::testing

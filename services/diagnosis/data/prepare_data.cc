#include "services/diagnosis/data/prepare_data.h"

#include "services/diagnosis/data/motion_survey.h"
#include "services/diagnosis/data/prescribed_doubt.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

namespace {

constexpr double kNodesPerRow = 20.0;  // at most: from 5 Hz on nodes are 10 ms apart

// Three windows at least.
Result<FitData> Prepared(const recordings::RecordingSet& set,
                         const std::vector<const recordings::Recording*>& recordings,
                         const sim::Plant& nominal, const DiagnosisOptions& options) {
  FitData data;
  data.n = nominal.num_joints();
  data.prescribed = nominal.prescribed();
  data.noise = WorkingNoise(recordings::EstimateSensorNoise(set), set.noise);
  const VectorXd values = nominal.parameters().Nominal();
  for (const recordings::Recording* rec : recordings) {
    if (rec->drive_effort().size() == 0) return InvalidError(rec->name + ": no effort drives the model");
    if (rec->rows() < 10) return InvalidError(rec->name + ": fewer than 10 rows, too little to fit");
    data.use_velocity = data.use_velocity && rec->has_velocity();
    data.places.push_back(static_cast<uint32_t>(rec - set.recordings.data()));
    data.recordings.push_back({rec, set.effort_excludes_gravity
                                        ? sysid::DriveSignalWithGravity(*rec, nominal, values)
                                        : sysid::DriveSignal(*rec)});
  }
  data.nodes.window_s = options.fit_window_s;
  // More nodes between rows that are far apart would cost memory for nothing.
  for (const sysid::FitRecording& r : data.recordings)
    data.nodes.interval_s = std::max(data.nodes.interval_s, r.recording->SamplePeriod() / kNodesPerRow);
  for (size_t r = 0; r < data.recordings.size(); ++r) {
    data.motions.emplace_back(*data.recordings[r].recording, data.noise);
    auto windows = CutIntoNodes(*data.recordings[r].recording, static_cast<int>(r), data.motions[r],
                                data.RowNoise(), data.nodes);
    data.windows.insert(data.windows.end(), windows.begin(), windows.end());
    data.fine.push_back(
        FineMotionOf(*data.recordings[r].recording, data.recordings[r].command, data.motions[r], data.nodes));
    // An effort recorded for an undriven joint has no effect.
    for (int j = 0; j < data.n; ++j) {
      if (nominal.IsPassive(j)) data.fine.back().u.row(j).setZero();
    }
  }
  if (data.windows.size() < 3)
    return InvalidError("less than three windows of motion: too little to say anything");
  AddPrescribedDoubt(nominal, options.threads, &data);
  return data;
}

}  // namespace

Result<FitData> PrepareData(const recordings::RecordingSet& set, const sim::Plant& nominal,
                            const DiagnosisOptions& options) {
  if (set.Fit().empty()) return InvalidError("no recording of the split \"fit\"");
  return Prepared(set, set.Fit(), nominal, options);
}

std::shared_ptr<const FitData> PrepareHeldOut(const recordings::RecordingSet& set, const FitData& fitted,
                                              const sim::Plant& nominal, const DiagnosisOptions& options) {
  if (set.Holdout().empty()) return nullptr;
  auto data = Prepared(set, set.Holdout(), nominal, options);
  if (!data.ok() || data->use_velocity != fitted.use_velocity) return nullptr;
  return std::make_shared<const FitData>(*std::move(data));
}

}  // namespace rg::diagnosis

#include "services/proof/concealed.h"

#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <vector>

#include "common/base/file.h"
#include "common/recordings/csv.h"
#include "common/recordings/recording_set.h"
#include "common/sim/model_file.h"
#include "services/proof/black_box.h"
#include "services/sysid/prediction.h"
#include "services/sysid/sysid_on_set.h"

namespace rg::proof {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr double kWindow = 1.0;  // s

using Predictor = std::function<Eigen::MatrixXd(const recordings::Recording&)>;

struct Squares {
  double sum = 0;
  long count = 0;
};

Result<Squares> ErrorOn(const std::string& file, const std::vector<std::string>& joints,
                        const Predictor& predict) {
  recordings::CsvOptions options;
  options.joints = joints;
  RG_ASSIGN_OR_RETURN(const recordings::Recording recording, recordings::LoadCsv(file, options));
  const Eigen::MatrixXd truth = recording.OtherKind("true_position");
  if (truth.size() == 0) return InvalidError(file + ": no columns true_position.<joint>");
  const Eigen::MatrixXd predicted = predict(recording);
  Squares out;
  for (int k = 1; k < recording.rows(); ++k) {
    for (int j = 0; j < recording.n(); ++j) {
      const double e = std::min(std::abs(predicted(j, k) - truth(j, k)), sysid::kErrorCap);
      out.sum += e * e, ++out.count;
    }
  }
  return out;
}

Result<double> RmsOnConcealed(const std::string& label_folder, const std::vector<std::string>& joints,
                              const Predictor& predict) {
  Squares all;
  for (int k = 0;; ++k) {
    char name[32];
    std::snprintf(name, sizeof name, "/hidden_%03d.csv", k);
    if (!fs::exists(label_folder + name)) break;
    RG_ASSIGN_OR_RETURN(const Squares one, ErrorOn(label_folder + name, joints, predict));
    all.sum += one.sum, all.count += one.count;
  }
  return all.count > 0 ? std::sqrt(all.sum / static_cast<double>(all.count))
                       : std::numeric_limits<double>::quiet_NaN();
}

Result<double> BlackBoxRms(const std::string& label_folder, const std::string& set_folder, Rng rng) {
  RG_ASSIGN_OR_RETURN(const recordings::RecordingSet set, recordings::LoadSet(set_folder));
  RG_ASSIGN_OR_RETURN(const sim::Plant nominal, sysid::NominalPlant(set));
  const auto box = BlackBox::Fit(nominal, set, rng);
  if (!box.ok()) return std::numeric_limits<double>::quiet_NaN();
  return RmsOnConcealed(label_folder, set.joints,
                        [&](const recordings::Recording& r) { return box->Predict(r, kWindow); });
}

}  // namespace

Result<PredictionMarks> PredictConcealed(const std::string& label_folder, const std::string& set_folder,
                                         const std::string& model_file, Rng rng) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(label_folder + "/oracle.json"));
  const json oracle = json::parse(text, nullptr, false);
  if (!oracle.is_object()) return DataLossError(label_folder + "/oracle.json: no JSON");
  PredictionMarks marks;
  marks.nominal = oracle.value("nominal_rms", std::numeric_limits<double>::quiet_NaN());
  marks.oracle = oracle.value("oracle_rms", std::numeric_limits<double>::quiet_NaN());
  marks.tool = std::numeric_limits<double>::quiet_NaN();
  RG_ASSIGN_OR_RETURN(marks.black_box, BlackBoxRms(label_folder, set_folder, rng));
  if (!fs::exists(model_file)) return marks;
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, sim::LoadModelFile(model_file));
  RG_ASSIGN_OR_RETURN(
      marks.tool,
      RmsOnConcealed(label_folder, model.plant.joint_names(), [&](const recordings::Recording& r) {
        sysid::PredictionOptions options;
        options.window_s = kWindow;
        return sysid::PredictRecording(model.plant, model.values, r, options).q;
      }));
  return marks;
}

}  // namespace rg::proof

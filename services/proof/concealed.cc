#include "services/proof/concealed.h"

#include <cmath>
#include <filesystem>
#include <limits>

#include "common/base/file.h"
#include "common/recordings/csv.h"
#include "common/sim/model_file.h"
#include "services/sysid/prediction.h"

namespace rg::proof {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

struct Squares {
  double sum = 0;
  long count = 0;
};

Result<Squares> ErrorOn(const std::string& file, const sim::ModelFile& model) {
  recordings::CsvOptions options;
  options.joints = model.plant.joint_names();
  RG_ASSIGN_OR_RETURN(const recordings::Recording recording, recordings::LoadCsv(file, options));
  const Eigen::MatrixXd truth = recording.OtherKind("true_position");
  if (truth.size() == 0) return InvalidError(file + ": no columns true_position.<joint>");
  const sysid::Prediction prediction = sysid::PredictRecording(model.plant, model.values, recording, {});
  Squares out;
  for (int k = 1; k < recording.rows(); ++k) {
    for (int j = 0; j < recording.n(); ++j) {
      const double e = std::min(std::abs(prediction.q(j, k) - truth(j, k)), sysid::kErrorCap);
      out.sum += e * e, ++out.count;
    }
  }
  return out;
}

}  // namespace

Result<PredictionMarks> PredictConcealed(const std::string& label_folder, const std::string& model_file) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(label_folder + "/oracle.json"));
  const json oracle = json::parse(text, nullptr, false);
  if (!oracle.is_object()) return DataLossError(label_folder + "/oracle.json: no JSON");
  PredictionMarks marks;
  marks.nominal = oracle.value("nominal_rms", std::numeric_limits<double>::quiet_NaN());
  marks.oracle = oracle.value("oracle_rms", std::numeric_limits<double>::quiet_NaN());
  marks.tool = std::numeric_limits<double>::quiet_NaN();
  if (!fs::exists(model_file)) return marks;
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, sim::LoadModelFile(model_file));
  Squares all;
  for (int k = 0;; ++k) {
    char name[32];
    std::snprintf(name, sizeof name, "/hidden_%03d.csv", k);
    if (!fs::exists(label_folder + name)) break;
    RG_ASSIGN_OR_RETURN(const Squares one, ErrorOn(label_folder + name, model));
    all.sum += one.sum, all.count += one.count;
  }
  if (all.count > 0) marks.tool = std::sqrt(all.sum / static_cast<double>(all.count));
  return marks;
}

}  // namespace rg::proof

#include "services/proof/concealed.h"

#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
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
constexpr int kPlotPoints = 150;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// n × K positions; empty: this predictor has nothing to say.
using Predictor = std::function<Eigen::MatrixXd(const recordings::Recording&)>;

struct Squares {
  double sum = 0;
  long count = 0;
  void Add(const Eigen::MatrixXd& error) {
    const auto later = error.rightCols(error.cols() - 1);  // the first row is measured
    sum += later.cwiseAbs().cwiseMin(sysid::kErrorCap).squaredNorm();
    count += later.size();
  }
  double rms() const { return count > 0 ? std::sqrt(sum / static_cast<double>(count)) : kNone; }
};

CasePlot PlotOf(const recordings::Recording& recording, const recordings::RecordingSet& set,
                const std::vector<Eigen::MatrixXd>& errors) {
  CasePlot plot;
  Eigen::Index joint = 0;
  errors[0].rowwise().squaredNorm().maxCoeff(&joint);
  plot.joint = recording.joints[static_cast<size_t>(joint)];
  plot.unit = set.joint_info[static_cast<size_t>(joint)].type == recordings::JointInfo::Type::kPrismatic
                  ? "m"
                  : "rad";
  const int step = std::max(1, recording.rows() / kPlotPoints);
  for (int k = 0; k < recording.rows(); k += step) {
    plot.t.push_back(recording.t[k] - recording.t[0]);
    std::vector<double>* const columns[] = {&plot.nominal, &plot.tool, &plot.black_box};
    for (size_t i = 0; i < 3; ++i) {
      columns[i]->push_back(errors[i].size() > 0 ? errors[i](joint, k) : kNone);
    }
  }
  return plot;
}

Predictor PredictorOf(const sim::Plant& plant, const Eigen::VectorXd& values, bool held_before = true) {
  return [&plant, &values, held_before](const recordings::Recording& recording) {
    sysid::PredictionOptions options;
    options.window_s = kWindow;
    options.held_before = held_before;
    return sysid::PredictRecording(plant, values, recording, options).q;
  };
}

Status Predict(const std::string& label_folder, const recordings::RecordingSet& set,
               const sim::Plant& nominal, const std::optional<sim::ModelFile>& model, Rng rng,
               Concealed* out) {
  const Eigen::VectorXd nominal_values = nominal.parameters().Nominal();
  const auto box = BlackBox::Fit(nominal, set, rng);
  const auto nothing = [](const recordings::Recording&) { return Eigen::MatrixXd(); };
  const std::vector<Predictor> predictors = {
      PredictorOf(nominal, nominal_values),
      model ? PredictorOf(model->plant, model->values, model->held_before) : Predictor(nothing),
      box.ok() ? Predictor([&](const recordings::Recording& r) { return box->Predict(r, kWindow); })
               : Predictor(nothing)};
  std::vector<Squares> all(predictors.size());
  for (int k = 0;; ++k) {
    char name[32];
    std::snprintf(name, sizeof name, "/hidden_%03d.csv", k);
    if (!fs::exists(label_folder + name)) break;
    recordings::CsvOptions options;
    options.joints = set.joints;
    RG_ASSIGN_OR_RETURN(const recordings::Recording recording,
                        recordings::LoadCsv(label_folder + name, options));
    const Eigen::MatrixXd truth = recording.OtherKind("true_position");
    if (truth.size() == 0) return InvalidError(label_folder + name + ": no columns true_position.<joint>");
    std::vector<Eigen::MatrixXd> errors;
    for (size_t i = 0; i < predictors.size(); ++i) {
      const Eigen::MatrixXd predicted = predictors[i](recording);
      errors.push_back(predicted.size() > 0 ? Eigen::MatrixXd(predicted - truth) : Eigen::MatrixXd());
      if (predicted.size() > 0) all[i].Add(errors[i]);
    }
    if (k == 0) out->plot = PlotOf(recording, set, errors);
  }
  out->marks.tool = all[1].rms(), out->marks.black_box = all[2].rms();
  return Status::Ok();
}

}  // namespace

Result<Concealed> PredictConcealed(const std::string& label_folder, const std::string& set_folder,
                                   const std::string& model_file, Rng rng) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(label_folder + "/oracle.json"));
  const json oracle = json::parse(text, nullptr, false);
  if (!oracle.is_object()) return DataLossError(label_folder + "/oracle.json: no JSON");
  Concealed out;
  // The nominal and the true model's errors are the generator's own.
  out.marks.nominal = oracle.value("nominal_rms", kNone);
  out.marks.oracle = oracle.value("oracle_rms", kNone);
  out.marks.tool = kNone;
  const auto refuse = [&](const Status& status) {
    out.refused = status.message();
    return out;
  };
  const auto set = recordings::LoadSet(set_folder);
  if (!set.ok()) return refuse(set.status());
  const auto nominal = sysid::NominalPlant(*set);
  if (!nominal.ok()) return refuse(nominal.status());
  std::optional<sim::ModelFile> model;
  if (fs::exists(model_file)) {
    auto read = sim::LoadModelFile(model_file);
    if (!read.ok()) return refuse(read.status());
    model = std::move(*read);
  }
  RG_RETURN_IF_ERROR(Predict(label_folder, *set, *nominal, model, rng, &out));
  return out;
}

}  // namespace rg::proof

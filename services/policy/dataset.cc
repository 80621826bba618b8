#include "services/policy/dataset.h"

#include <cmath>

namespace rg::policy {
namespace {

Status CheckFinite(const Eigen::MatrixXf& values, const char* what) {
  if (values.allFinite()) return Status::Ok();
  for (Eigen::Index col = 0; col < values.cols(); ++col) {
    for (Eigen::Index row = 0; row < values.rows(); ++row) {
      if (std::isfinite(values(row, col))) continue;
      return InvalidError("dataset: point " + std::to_string(col) + ", " + what + " " + std::to_string(row) +
                          ": not finite");
    }
  }
  return Status::Ok();
}

std::string Shape(const Dataset& d) {
  return std::to_string(d.inputs.rows()) + " inputs, " + std::to_string(d.outputs.rows()) + " outputs";
}

}  // namespace

void Dataset::AddTrajectory(uint64_t id, const Eigen::MatrixXd& q, const Eigen::MatrixXd& v,
                            const Eigen::VectorXd& goal, const Eigen::MatrixXd& effort) {
  const Eigen::Index n = q.rows(), count = q.cols(), old = inputs.cols();
  RG_CHECK(v.rows() == n && v.cols() == count && goal.size() == n && effort.cols() == count)
      << "q " << n << " x " << count << ", v " << v.rows() << " x " << v.cols() << ", goal " << goal.size()
      << ", effort " << effort.rows() << " x " << effort.cols();
  RG_CHECK(old == 0 || (inputs.rows() == 3 * n && outputs.rows() == effort.rows()))
      << Shape(*this) << ", trajectory of " << n << " joints";
  inputs.conservativeResize(3 * n, old + count);
  outputs.conservativeResize(effort.rows(), old + count);
  inputs.block(0, old, n, count) = q.cast<float>();
  inputs.block(n, old, n, count) = v.cast<float>();
  inputs.block(2 * n, old, n, count).colwise() = goal.cast<float>();
  outputs.rightCols(count) = effort.cast<float>();
  trajectory.insert(trajectory.end(), static_cast<size_t>(count), id);
}

Status CheckDataset(const Dataset& d) {
  if (d.size() == 0 || d.inputs.rows() == 0 || d.outputs.rows() == 0)
    return InvalidError("dataset: is empty");
  if (d.outputs.cols() != d.inputs.cols() ||
      static_cast<Eigen::Index>(d.trajectory.size()) != d.inputs.cols()) {
    return InvalidError("dataset: " + std::to_string(d.inputs.cols()) + " inputs, " +
                        std::to_string(d.outputs.cols()) + " outputs and " +
                        std::to_string(d.trajectory.size()) + " trajectory ids, must be as many");
  }
  RG_RETURN_IF_ERROR(CheckFinite(d.inputs, "input"));
  return CheckFinite(d.outputs, "output");
}

Status Append(Dataset* dataset, const Dataset& more) {
  if (more.size() == 0) return Status::Ok();
  if (dataset->size() == 0) {
    *dataset = more;
    return Status::Ok();
  }
  if (dataset->inputs.rows() != more.inputs.rows() || dataset->outputs.rows() != more.outputs.rows()) {
    return InvalidError("dataset: points with " + Shape(more) + " do not go with points with " +
                        Shape(*dataset));
  }
  const Eigen::Index old = dataset->inputs.cols();
  dataset->inputs.conservativeResize(Eigen::NoChange, old + more.inputs.cols());
  dataset->outputs.conservativeResize(Eigen::NoChange, old + more.outputs.cols());
  dataset->inputs.rightCols(more.inputs.cols()) = more.inputs;
  dataset->outputs.rightCols(more.outputs.cols()) = more.outputs;
  dataset->trajectory.insert(dataset->trajectory.end(), more.trajectory.begin(), more.trajectory.end());
  return Status::Ok();
}

}  // namespace rg::policy

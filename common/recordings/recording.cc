#include "common/recordings/recording.h"

#include <algorithm>

namespace rg::recordings {
namespace {

Eigen::MatrixXd PickRows(const Eigen::MatrixXd& x, const std::vector<int>& rows) {
  if (x.size() == 0) return {};
  Eigen::MatrixXd picked(static_cast<Eigen::Index>(rows.size()), x.cols());
  for (size_t i = 0; i < rows.size(); ++i) picked.row(static_cast<Eigen::Index>(i)) = x.row(rows[i]);
  return picked;
}

// Of `some` old rows, where they are among the picked ones.
std::vector<int> PickedOf(const std::vector<int>& some, const std::vector<int>& rows) {
  std::vector<int> out;
  for (size_t i = 0; i < rows.size(); ++i) {
    if (std::find(some.begin(), some.end(), rows[i]) != some.end()) out.push_back(static_cast<int>(i));
  }
  return out;
}

Eigen::MatrixXd PickCols(const Eigen::MatrixXd& x, int first, int count) {
  if (x.size() == 0) return {};
  return x.middleCols(first, count);
}

}  // namespace

bool Recording::IsPrescribed(int joint) const {
  return std::binary_search(prescribed.begin(), prescribed.end(), joint);
}

Eigen::MatrixXd Recording::OtherKind(const std::string& kind) const {
  Eigen::MatrixXd all(n(), rows());
  for (int i = 0; i < n(); ++i) {
    const auto column = other.find(kind + "." + joints[static_cast<size_t>(i)]);
    if (column == other.end()) return {};
    all.row(i) = column->second.transpose();
  }
  return all;
}

double Recording::SamplePeriod() const {
  if (rows() < 2) return 0.0;
  std::vector<double> steps(static_cast<size_t>(rows() - 1));
  for (size_t k = 0; k < steps.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    steps[k] = t[i + 1] - t[i];
  }
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle;
}

Result<Recording> Reorder(const Recording& recording, const std::vector<std::string>& joints) {
  std::vector<int> rows;
  for (const std::string& joint : joints) {
    const auto found = std::find(recording.joints.begin(), recording.joints.end(), joint);
    if (found == recording.joints.end()) {
      return InvalidError(recording.name + ": the recording has no joint '" + joint + "'");
    }
    rows.push_back(static_cast<int>(found - recording.joints.begin()));
  }
  Recording picked = recording;
  picked.joints = joints;
  picked.q = PickRows(recording.q, rows);
  picked.v = PickRows(recording.v, rows);
  picked.effort_command = PickRows(recording.effort_command, rows);
  picked.effort_measured = PickRows(recording.effort_measured, rows);
  picked.prescribed = PickedOf(recording.prescribed, rows);
  picked.without_velocity = PickedOf(recording.without_velocity, rows);
  return picked;
}

Recording Slice(const Recording& recording, int first, int count) {
  RG_CHECK(first >= 0 && count >= 0 && first + count <= recording.rows())
      << recording.name << ": rows " << first << " + " << count << " of " << recording.rows();
  Recording part = recording;
  part.t = recording.t.segment(first, count);
  part.q = PickCols(recording.q, first, count);
  part.v = PickCols(recording.v, first, count);
  part.effort_command = PickCols(recording.effort_command, first, count);
  part.effort_measured = PickCols(recording.effort_measured, first, count);
  for (auto& [name, column] : part.other) column = Eigen::VectorXd(column.segment(first, count));
  return part;
}

}  // namespace rg::recordings

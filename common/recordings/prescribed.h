// Joints that move as measured: another controller holds them, and no effort of theirs is known. Which they
// are (recording_set.h), and their velocities where no column gives them.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/base/rng.h"
#include "common/base/status.h"
#include "common/recordings/recording.h"
#include "common/recordings/recording_set.h"

namespace rg::recordings {

// Makes the rows of v in `without_velocity` the slope of the positions; again after positions have changed.
void FillVelocities(Recording* recording);

// Fills set->prescribed from what the readers found in each recording. Where the manifest lists none, a joint
// is prescribed that has an effort in no recording while others have; one that has it in some of them is an
// error that names a file without.
Status ResolvePrescribed(RecordingSet* set);

// The motion of prescribed joints at each row, m × K each, in the order of `prescribed`.
struct SmoothMotionRows {
  Eigen::MatrixXd q, v, a;
};
// By Rauch, Tung and Striebel's smoother over a motion whose acceleration wanders (white jerk), from
// positions and, where they are measured, velocities, each with its own noise; how much it wanders is what
// makes the rows likeliest. So the motion stays within the noise of what was measured, and its acceleration
// is of use, which differences of noisy rows are not.
SmoothMotionRows SmoothPrescribed(const Recording& recording);

// Ways in which the true motion of one joint may differ from the smooth one: columns, independent of each
// other, each as large as its standard deviation; rows × ways each.
struct WaysToDiffer {
  Eigen::MatrixXd q, v, a;
};

// How well the smooth motion of prescribed joints is known: the joint distribution of all rows, as the
// smoother has it.
class PrescribedDoubt {
 public:
  explicit PrescribedDoubt(const Recording& recording);
  ~PrescribedDoubt();
  PrescribedDoubt(PrescribedDoubt&&) noexcept;

  // Of recording.prescribed[i] in rows [first, last]; all but a hundredth of the acceleration's variance
  // there.
  WaysToDiffer Ways(int i, int first, int last) const;
  // A motion that may as well be the true one.
  SmoothMotionRows Draw(Rng& rng) const;

 private:
  struct Joint;
  std::vector<Joint> joints_;
};

// "lift_joint moves as measured (prescribed): it has no effort column, others have"; empty: there is none.
std::string NoteOnPrescribed(const RecordingSet& set);

}  // namespace rg::recordings

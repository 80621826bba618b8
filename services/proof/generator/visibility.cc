#include "services/proof/generator/visibility.h"

#include <algorithm>
#include <cmath>

#include "services/proof/generator/likeness.h"
#include "services/proof/generator/siblings.h"
#include "services/proof/generator/tuning.h"

namespace rg::proof {
namespace {

constexpr double kVisible = 1.1;  // error of a model without an effect over the true one's
// Deviation of a model, from the true state, over the sensors' noise: less than what stands out of
// predictions that begin at noisy rows, but many rows tell it.
constexpr double kShows = 1.0;
// Log evidence, on average over the noise, that tells an effect from other masses: a name costs about 14 (its
// odds, and four for each of its numbers), which 32 ± √64 exceeds in 98 of 100 draws of the noise.
constexpr double kTells = 32.0;

}  // namespace

bool Visibility::StandsOut(const Truth& truth, const Truth& model) const {
  WindowSquares squares;
  compared.Add(truth, track, {{compared.bodies(), model}}, &squares);
  return Rms(squares.rivals[0]) > kVisible * Rms(squares.oracle);
}

std::vector<bool> Visibility::ShowEach(const Truth& truth, const std::vector<Truth>& models) const {
  std::vector<Rival> rivals;
  for (const Truth& model : models) rivals.push_back({compared.bodies(), model, Start::kTrue});
  WindowSquares squares;
  compared.Add(truth, track, rivals, &squares);
  const double count = static_cast<double>(joints.size());
  std::vector<bool> show;
  for (const auto& s : squares.rivals) show.push_back(std::sqrt(count) * Rms(s) > kShows * noise);
  return show;
}

bool Visibility::Shows(const Truth& truth, const std::vector<Truth>& models) const {
  const std::vector<bool> show = ShowEach(truth, models);
  return std::find(show.begin(), show.end(), false) == show.end();
}

bool Visibility::ShowsAsMore(const Truth& truth, const std::string& effect, size_t joint) const {
  const double load = track.u.row(static_cast<Eigen::Index>(joint)).cwiseAbs().mean();
  return Shows(truth, SimplerSiblings(truth, effect, joint, load, tool));
}

bool Visibility::LooksLikeBodies(const Truth& truth, const Truth& without,
                                 const std::vector<std::string>& on) const {
  if (!std::all_of(for_bodies.begin(), for_bodies.end(), [](const Track& t) { return t.ok; })) return false;
  const double left =
      LeftByNearestBodies(compared, truth, for_bodies, without, LinksBeside(on, joints, links), noise);
  return 0.5 * left * fit_s < kTells;
}

std::vector<std::string> Visibility::JointsThatShow(const Truth& truth, const nlohmann::json& effect,
                                                    const std::set<std::string>& shared,
                                                    bool from_bodies) const {
  std::vector<std::string> show;
  const std::vector<std::string> named = effect["joints"];
  for (const std::string& name : named) {
    const auto joint = static_cast<size_t>(std::find(joints.begin(), joints.end(), name) - joints.begin());
    if (named.size() > 1 && shared.count(name) == 0) {
      Truth without = truth;
      without.joint[joint] = JointTruth{};
      if (!StandsOut(truth, without)) continue;
      if (from_bodies && LooksLikeBodies(truth, without, {name})) continue;
    }
    if (ShowsAsMore(truth, effect["id"], joint)) show.push_back(name);
  }
  return show;
}

}  // namespace rg::proof

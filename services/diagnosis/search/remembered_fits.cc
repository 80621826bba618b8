#include "services/diagnosis/search/remembered_fits.h"

#include <cstring>
#include <type_traits>
#include <utility>

#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

namespace {

class KeyText {
 public:
  void Add(const std::string& text) { text_ += text, text_ += '\0'; }
  template <class Number>
  requires std::is_arithmetic_v<Number>
  void Add(Number value) {
    char bytes[sizeof(Number)];
    std::memcpy(bytes, &value, sizeof(Number));
    text_.append(bytes, sizeof(Number));
  }
  void Add(const Eigen::MatrixXd& m) {
    Add(m.rows()), Add(m.cols());
    for (Eigen::Index i = 0; i < m.size(); ++i) Add(m.data()[i]);
  }
  std::string Text() && { return std::move(text_); }

 private:
  std::string text_;
};

// All that a request's result depends on; of the start its values, its χ² and its first and last windows,
// since all of its states would be megabytes.
std::string RequestKey(const FitRequest& request) {
  KeyText key;
  key.Add(KeyOf(request.specs, request.base));
  for (const effects::EffectSpec& s : request.specs) {
    key.Add(s.id);
    for (const auto& [owner, values] : s.values) {
      key.Add(owner);
      for (const auto& [name, value] : values) key.Add(name), key.Add(value);
    }
  }
  const LiftedOptions& o = request.options;
  key.Add(o.iterations), key.Add(o.more_iterations), key.Add(o.still_falling), key.Add(o.to_beat);
  key.Add(o.noise_scale), key.Add(o.step_s), key.Add(o.free_hidden), key.Add(static_cast<int>(o.integrator));
  key.Add(request.places.size());
  for (const uint32_t place : request.places) key.Add(place);
  key.Add(request.piece_s), key.Add(request.pieces_alone);
  if (request.from != nullptr) {
    const Candidate& from = *request.from;
    key.Add(KeyOf(from.specs, from.base));
    key.Add(from.fit.values), key.Add(from.fit.chi2), key.Add(from.fit.step_s),
        key.Add(from.fit.states.size());
    if (!from.fit.states.empty()) key.Add(from.fit.states.front()), key.Add(from.fit.states.back());
  }
  return std::move(key).Text();
}

class RememberedBatch : public FitBatch {
 public:
  RememberedBatch(std::vector<std::string> keys, std::map<std::string, size_t> places,
                  std::unique_ptr<FitBatch> fresh, std::map<std::string, FitResult>& made)
      : keys_(std::move(keys)), places_(std::move(places)), fresh_(std::move(fresh)), made_(made) {}

  FitResult Take(size_t i) override {
    const auto known = made_.find(keys_[i]);
    if (known != made_.end()) {
      FitResult result = known->second;
      result.work = 0;
      return result;
    }
    return made_.emplace(keys_[i], fresh_->Take(places_.at(keys_[i]))).first->second;
  }

 private:
  std::vector<std::string> keys_;
  std::map<std::string, size_t> places_;  // among the fresh ones
  std::unique_ptr<FitBatch> fresh_;
  std::map<std::string, FitResult>& made_;
};

}  // namespace

std::unique_ptr<FitBatch> RememberedFits::Start(const FitSetting& setting, std::vector<FitRequest> requests) {
  std::vector<std::string> keys;
  std::vector<FitRequest> fresh;
  std::map<std::string, size_t> places;
  for (FitRequest& request : requests) {
    keys.push_back(RequestKey(request));
    if (made_.count(keys.back()) == 0 && places.emplace(keys.back(), fresh.size()).second)
      fresh.push_back(std::move(request));
  }
  auto batch = fits_.Start(setting, std::move(fresh));
  return std::make_unique<RememberedBatch>(std::move(keys), std::move(places), std::move(batch), made_);
}

}  // namespace rg::diagnosis

#include "services/diagnosis/fit_requests.h"

#include "services/diagnosis/hypotheses.h"

namespace rg::diagnosis {

using Eigen::VectorXd;

namespace {

FitResult FitOn(const FitData& data, const Candidate& c, const FitRequest& request) {
  FitModel model{*c.plant, c.plant->parameters().Nominal(), c.parameters};
  const Candidate* from = request.from.get();
  if (from == nullptr) return Fit(data, model, request.options);
  if (c.base && from->base) {
    const VectorXd nominal = model.values;
    model.values = c.plant->ValuesFrom(from->plant->parameters(), from->fit.values);
    for (int i = 0; i < nominal.size(); ++i) {
      if (c.plant->parameters()[i].kind == sim::ParameterKind::kEffect) model.values[i] = nominal[i];
    }
  }
  NodeStates states = from->fit.states;
  if (!request.places.empty()) {
    states.clear();
    for (const uint32_t i : request.places) states.push_back(from->fit.states[i]);
  }
  const NodeStates start = CarriedStates(data, model, *from->plant, states, request.options);
  return Fit(data, model, request.options, &start);
}

class LocalBatch final : public FitBatch {
 public:
  LocalBatch(const FitSetting& setting, std::vector<FitRequest> requests)
      : setting_(setting), requests_(std::move(requests)) {}
  FitResult Take(size_t i) override { return MakeFit(setting_, requests_[i]); }

 private:
  FitSetting setting_;
  std::vector<FitRequest> requests_;
};

}  // namespace

Candidate Unfitted(const FitSetting& setting, const std::vector<effects::EffectSpec>& specs, bool base) {
  Candidate c;
  c.specs = specs, c.base = base;
  auto plant = sim::Plant::Create(setting.nominal.shared_model(), setting.nominal.options(), specs);
  if (!plant.ok()) return c;
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, setting.scales, base);
  return c;
}

FitResult MakeFit(const FitSetting& setting, const FitRequest& request) {
  const Candidate c = Unfitted(setting, request.specs, request.base);
  if (c.plant == nullptr) return {};
  if (request.places.empty()) return FitOn(setting.data, c, request);
  FitData some = setting.data;
  some.windows.clear();
  for (const uint32_t i : request.places) some.windows.push_back(setting.data.windows[i]);
  return FitOn(some, c, request);
}

std::unique_ptr<FitBatch> LocalFits::Start(const FitSetting& setting, std::vector<FitRequest> requests) {
  return std::make_unique<LocalBatch>(setting, std::move(requests));
}

}  // namespace rg::diagnosis

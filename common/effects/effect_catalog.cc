#include "common/effects/effect_catalog.h"

#include "common/effects/effect_list.h"
#include "common/effects/inference.h"

namespace rg::effects {
namespace {

template <class E>
EffectTraits Traits() {
  EffectTraits traits{E::kRole, {static_cast<int>(E::kPhase)}, {}};
  if constexpr (requires { E::kPhaseByOption; }) {
    traits.phases.clear();
    for (const Phase phase : E::kPhaseByOption) traits.phases.push_back(static_cast<int>(phase));
  }
  if constexpr (StatesOf<E>() > 0) {
    for (const char* name : E::kStateNames) traits.state_names.emplace_back(name);
  }
  return traits;
}

template <class E>
Inference Inferred() {
  if constexpr (requires { E::Inferred(); }) {
    return E::Inferred();
  } else {
    return {};
  }
}

template <class... E>
std::vector<Inference> AllInferred(TypeList<E...>) {
  return {Inferred<E>()...};
}
template <class... E>
std::vector<EffectInfo> Rows(TypeList<E...>) {
  return {E::Info()...};
}
template <class... E>
std::vector<EffectTraits> AllTraits(TypeList<E...>) {
  return {Traits<E>()...};
}

}  // namespace

const std::vector<EffectInfo>& Catalog() {
  static const auto& rows = *new std::vector<EffectInfo>(Rows(EffectList{}));
  return rows;
}

int KindOf(std::string_view id) {
  const auto& rows = Catalog();
  for (size_t i = 0; i < rows.size(); ++i) {
    if (rows[i].id == id) return static_cast<int>(i);
  }
  return -1;
}

const EffectInfo* FindEffect(std::string_view id) {
  const int kind = KindOf(id);
  return kind < 0 ? nullptr : &Catalog()[kind];
}

const EffectTraits& TraitsOf(int kind) {
  static const auto& all = *new std::vector<EffectTraits>(AllTraits(EffectList{}));
  return all[kind];
}

const Inference& InferenceOf(std::string_view id) {
  static const auto& all = *new std::vector<Inference>(AllInferred(EffectList{}));
  static const Inference none;
  const int kind = KindOf(id);
  return kind < 0 ? none : all[static_cast<size_t>(kind)];
}

}  // namespace rg::effects

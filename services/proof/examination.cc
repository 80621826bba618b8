#include "services/proof/examination.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

namespace rg::proof {

using nlohmann::json;

namespace {

constexpr double kCounts = 0.3;  // confidence at which a finding counts

bool SameFamily(const std::string& a, const std::string& b) {
  static const std::vector<std::set<std::string>> families = {
      {"viscous_friction", "coulomb_friction", "stribeck_friction", "asymmetric_friction",
       "load_dependent_friction", "presliding_hysteresis", "thermal_drift", "quadratic_drag"},
      {"actuator_delay", "actuator_lag", "sensor_delay"},
      {"joint_elasticity", "backlash"},
      {"torque_gain", "torque_saturation", "torque_deadband"},
      {"torque_offset", "asymmetric_friction"},
      {"payload", "sloshing_payload", "parameters_only"},
      {"gravity_misalignment", "encoder_offset", "base_flexibility"},
      {"rotor_inertia", "parameters_only"},
      {"position_spring", "contact", "unknown_field"}};
  return std::any_of(families.begin(), families.end(),
                     [&](const auto& f) { return f.count(a) > 0 && f.count(b) > 0; });
}

const std::string kParameters = "parameters_only";
bool OutsideCatalogue(const std::string& id) { return id == "unknown_field"; }
// What the recordings' contract counts as found where the verdict is `unexplained`.
bool MayBeUnnamed(const std::string& id) {
  return OutsideCatalogue(id) || id == "sloshing_payload" || id == "base_flexibility";
}

std::vector<std::string> Strings(const json& object, const char* key) {
  std::vector<std::string> out;
  for (const json& x : object.value(key, json::array())) {
    if (x.is_string()) out.push_back(x.get<std::string>());
  }
  return out;
}

// `otherwise` also where it is null: of a model that cannot be simulated.
double NumberOr(const json& object, const char* key, double otherwise) {
  const auto at = object.find(key);
  return at != object.end() && at->is_number() ? at->get<double>() : otherwise;
}

bool Has(const std::vector<std::string>& list, const std::string& x) {
  return std::find(list.begin(), list.end(), x) != list.end();
}

double NameMark(const json& effect, const std::string& said) {
  const std::string id = effect.at("id");
  if (said == id || Has(Strings(effect, "equivalents"), said)) return 1.0;
  return SameFamily(id, said) ? 0.5 : 0.0;
}

struct Said {
  std::string effect;
  std::vector<std::string> joints;
  double confidence = 0;
  json parameters;
};

std::vector<Said> FindingsOf(const json& diagnosis) {
  std::vector<Said> out;
  if (!diagnosis.is_object()) return out;
  for (const json& f : diagnosis.value("findings", json::array())) {
    out.push_back({f.value("effect", ""), Strings(f, "joints"), f.value("confidence", 0.5),
                   f.value("parameters", json::object())});
  }
  std::stable_sort(out.begin(), out.end(),
                   [](const Said& a, const Said& b) { return a.confidence > b.confidence; });
  return out;
}

std::string Listed(const std::string& id, const std::vector<std::string>& joints) {
  std::string text = id;
  for (size_t i = 0; i < joints.size(); ++i) text += (i == 0 ? " [" : ", ") + joints[i];
  return text + (joints.empty() ? "" : "]");
}

// What the label asks to be named: wrong parameters beside an effect need not be.
std::vector<json> Asked(const json& label) {
  std::vector<json> effects, physics;
  for (const json& e : label.at("effects")) {
    effects.push_back(e);
    if (e.at("id") != kParameters) physics.push_back(e);
  }
  return physics.empty() ? effects : physics;
}

class Marker {
 public:
  Marker(const json& label, const json& diagnosis, CaseMarks* marks)
      : label_(label), asked_(Asked(label)), said_(FindingsOf(diagnosis)), m_(*marks) {
    for (const json& e : label.at("effects")) {
      for (const std::string& ok : Strings(e, "also_acceptable")) allowed_.insert(ok);
      if (e.at("id") == kParameters) allowed_.insert(kParameters);
    }
  }

  void Run() {
    if (m_.kind == CaseKind::kControl || m_.kind == CaseKind::kDeclared) return Control();
    First();
    F1();
    Joints();
    JointsF1();
    Parameters();
    for (const Said& s : said_) m_.calls.push_back({s.confidence, Holds(s)});
  }

 private:
  double Best(const std::string& effect) const {
    double best = 0;
    for (const json& e : asked_) best = std::max(best, NameMark(e, effect));
    return best;
  }
  bool Holds(const Said& s) const { return Best(s.effect) == 1.0 || allowed_.count(s.effect) > 0; }
  // True beside the answer, but not the answer.
  bool SideRemark(const Said& s) const { return allowed_.count(s.effect) > 0 && Best(s.effect) < 1.0; }

  void Control() {
    const bool parameters = !asked_.empty();
    const std::string wanted = parameters ? kParameters : std::string("no_mismatch");
    bool physics = false, all_equivalent = true;
    for (const Said& s : said_) {
      if (s.effect == "none" || s.effect == kParameters) continue;
      physics = true;
      all_equivalent = all_equivalent && Best(s.effect) == 1.0;
    }
    const bool excused = physics && all_equivalent;
    if (m_.kind == CaseKind::kDeclared) {
      m_.false_alarm = !m_.diagnosed || m_.verdict != "no_mismatch" || !said_.empty();
      m_.first = m_.f1 = m_.f1_or_unexplained = m_.false_alarm ? 0.0 : 1.0;
      for (const Said& s : said_) m_.calls.push_back({s.confidence, false});
      return;
    }
    m_.false_alarm =
        !m_.diagnosed || ((m_.verdict == "unmodelled_physics" || m_.verdict == "unexplained") && !excused);
    m_.first = m_.verdict == wanted || (excused && !m_.false_alarm) ? 1.0 : m_.false_alarm ? 0.0 : 0.5;
    m_.f1 = m_.f1_or_unexplained = m_.first;
    for (const Said& s : said_) m_.calls.push_back({s.confidence, Holds(s)});
  }

  void First() {
    const Said* top = nullptr;
    for (const Said& s : said_) {
      if (top == nullptr && !SideRemark(s)) top = &s;
    }
    if (top == nullptr && !said_.empty()) top = &said_.front();
    if (top != nullptr) {
      m_.first = Best(top->effect);
    } else if (m_.verdict == kParameters) {
      m_.first = Best(kParameters);
    }
    if (m_.kind == CaseKind::kOpen) {
      const bool named = top != nullptr && top->effect == "unknown_field";
      m_.first = m_.verdict == "unexplained" && named ? 1.0 : m_.verdict == "unexplained" ? 0.5 : m_.first;
    }
  }

  // Every effect of the label can be matched once. Beside `unexplained` an unnamed force matches one that the
  // recordings' contract lets be unnamed, in the second mark.
  void F1() {
    std::vector<json> left = asked_;
    double hits = 0;
    int extra = 0;
    std::set<std::string> names;
    std::vector<std::string> ordered;
    for (const Said& s : said_) {
      if (s.confidence >= kCounts && names.insert(s.effect).second) ordered.push_back(s.effect);
    }
    std::stable_sort(ordered.begin(), ordered.end(),
                     [this](const auto& a, const auto& b) { return Best(a) > Best(b); });
    for (const std::string& name : ordered) {
      auto at = left.end();
      double mark = 0;
      for (auto e = left.begin(); e != left.end(); ++e) {
        if (NameMark(*e, name) > mark) mark = NameMark(*e, name), at = e;
      }
      if (mark < 1.0 && allowed_.count(name) > 0) continue;
      if (at == left.end()) {
        ++extra;
      } else {
        hits += mark;
        left.erase(at);
      }
    }
    const auto f1 = [&] {
      const double matched = static_cast<double>(asked_.size() - left.size());
      const double precision = matched + extra > 0 ? hits / (matched + extra) : 0.0;
      const double recall = hits / static_cast<double>(asked_.size());
      return precision + recall > 0 ? 2 * precision * recall / (precision + recall) : 0.0;
    };
    m_.f1 = f1();
    const auto may_be_unnamed = [](const json& e) { return MayBeUnnamed(e.at("id")); };
    if (m_.verdict == "unexplained" && std::erase_if(left, may_be_unnamed) > 0)
      hits += 1, extra = std::max(0, extra - 1);
    m_.f1_or_unexplained = f1();
  }

  // Findings that speak of this effect: rightly named, else of its family.
  std::vector<const Said*> About(const json& effect) const {
    std::vector<const Said*> exact, family;
    for (const Said& s : said_) {
      const double mark = NameMark(effect, s.effect);
      if (mark == 1.0) exact.push_back(&s);
      if ((mark > 0 || OutsideCatalogue(effect.at("id"))) && !SideRemark(s)) family.push_back(&s);
    }
    return exact.empty() ? family : exact;
  }

  // Without the joints that may be named or left out.
  static std::set<std::string> Due(const json& effect, std::set<std::string> joints) {
    for (const std::string& optional : Strings(effect, "optional_joints")) joints.erase(optional);
    return joints;
  }

  // Pairs of the label's effects on joints and the findings' joints; a finding that is no effect of the
  // label's is wrong on all its joints, one that the label allows beside it is asked for none.
  void JointsF1() {
    double hits = 0, said = 0, truth = 0;
    std::set<const Said*> counted;
    for (const json& e : asked_) {
      if (e.value("localisation", "") != "joints") continue;
      std::set<std::string> of_findings;
      for (const Said& s : said_) {
        if (s.confidence < kCounts || NameMark(e, s.effect) < 1.0 || !counted.insert(&s).second) continue;
        of_findings.insert(s.joints.begin(), s.joints.end());
      }
      const std::vector<std::string> joints = Strings(e, "joints");
      const auto asked = Due(e, {joints.begin(), joints.end()}), named = Due(e, of_findings);
      truth += static_cast<double>(asked.size()), said += static_cast<double>(named.size());
      hits += static_cast<double>(
          std::count_if(named.begin(), named.end(), [&](const auto& j) { return asked.count(j) > 0; }));
    }
    for (const Said& s : said_) {
      if (s.confidence >= kCounts && counted.count(&s) == 0 && !Holds(s))
        said += static_cast<double>(s.joints.size());
    }
    if (said + truth > 0) m_.joints_f1 = 2 * hits / (said + truth);
  }

  // All of them; of a force outside the catalogue the label lists the joint it acts on and then those it
  // depends on, which a finding may leave out.
  static bool Right(const json& effect, const std::set<std::string>& said,
                    const std::set<std::string>& truth) {
    if (!OutsideCatalogue(effect.at("id"))) return Due(effect, said) == Due(effect, truth);
    return said.count(Strings(effect, "joints").front()) > 0 &&
           std::includes(truth.begin(), truth.end(), said.begin(), said.end());
  }

  // Not asked of an equivalent name that speaks of the body or its base instead of joints.
  void Joints() {
    static const std::set<std::string> of_body = {kParameters, "payload", "gravity_misalignment"};
    for (const json& e : asked_) {
      if (e.value("localisation", "") != "joints") continue;
      std::set<std::string> said, truth;
      for (const std::string& j : Strings(e, "joints")) truth.insert(j);
      const std::vector<const Said*> about = About(e);
      for (const Said* s : about) said.insert(s->joints.begin(), s->joints.end());
      if (!about.empty() && std::all_of(about.begin(), about.end(), [&](const Said* s) {
            return NameMark(e, s->effect) == 1.0 && of_body.count(s->effect) > 0;
          })) {
        continue;
      }
      m_.joints_exact = m_.joints_exact.value_or(true) && Right(e, said, truth);
    }
  }

  void Parameters() {
    for (const json& e : asked_) {
      for (const Said* s : About(e)) {
        if (s->effect != e.at("id")) continue;
        const json truths = e.value("parameters", json::object());
        for (const auto& [owner, rows] : truths.items()) {
          for (const auto& [name, row] : rows.items()) {
            if (!row.contains("value") || !row["value"].is_number()) continue;
            const json::json_pointer at("/" + owner + "/" + name + "/value");
            if (!s->parameters.contains(at) || !s->parameters[at].is_number()) continue;
            // Secondary shapes (a damping, a phase, a place) are for information.
            static const std::set<std::string> secondary = {
                "damping",         "motor_inertia", "phase", "azimuth", "contact_stiffness",
                "contact_damping", "com_x",         "com_y", "com_z",   "cubic",
                "center"};
            if (secondary.count(name) > 0) continue;
            const double truth = row["value"], value = s->parameters[at];
            const double reference = name == "gain" ? truth - 1 : truth;
            m_.parameter_errors.push_back(reference != 0 ? std::abs((value - truth) / reference)
                                                         : std::abs(value));
          }
        }
      }
    }
  }

  const json& label_;
  std::vector<json> asked_;
  std::vector<Said> said_;
  std::set<std::string> allowed_;
  CaseMarks& m_;
};

}  // namespace

std::optional<double> PredictionMarks::recovered_by(double rms) const {
  if (!(nominal >= 1.3 * oracle) || !std::isfinite(nominal)) return std::nullopt;
  return std::isfinite(rms) ? (nominal - rms) / (nominal - oracle) : 0.0;
}

double PredictionMarks::against_oracle() const {
  return (std::isfinite(tool) ? tool : nominal) / std::max(1e-12, oracle);
}

Result<CaseMarks> Mark(const json& label, const json& diagnosis, const PredictionMarks& prediction) {
  CaseMarks m;
  try {
    m.name = label.at("name"), m.robot = label.at("robot");
    m.weak = label.value("weak", false), m.tuned = label.value("tuned", false);
    m.rate_hz = label.value("rate_hz", 0.0);
    for (const json& e : label.at("effects")) {
      m.effects.push_back(e.at("id"));
      m.truth.push_back(Listed(e.at("id"), Strings(e, "joints")));
    }
    const std::vector<json> asked = Asked(label);
    const std::string stratum = label.value("stratum", "");
    const bool control =
        std::all_of(asked.begin(), asked.end(), [](const json& e) { return e.at("id") == kParameters; });
    // Labels of other origin say no stratum; only an ordinary robot lacks three things and more.
    const bool ordinary = stratum == "ordinary" || (stratum.empty() && asked.size() > 2);
    m.kind = stratum == "declared"                                         ? CaseKind::kDeclared
             : ordinary                                                    ? CaseKind::kOrdinary
             : control                                                     ? CaseKind::kControl
             : asked.size() > 1                                            ? CaseKind::kPair
             : OutsideCatalogue(asked.front().at("id").get<std::string>()) ? CaseKind::kOpen
                                                                           : CaseKind::kSingle;
    m.diagnosed = diagnosis.is_object();
    m.prediction = prediction;
    if (m.diagnosed) {
      m.verdict = diagnosis.value("verdict", "");
      m.seconds = diagnosis.value("elapsed_s", 0.0);
    }
    for (const Said& s : FindingsOf(diagnosis)) {
      char confidence[16];
      std::snprintf(confidence, sizeof confidence, " %.2f", s.confidence);
      m.said.push_back(Listed(s.effect, s.joints) + confidence);
    }
    const json holdout =
        m.diagnosed ? diagnosis.value(json::json_pointer("/fit/holdout"), json::object()) : json::object();
    const double before = NumberOr(holdout, "before_rms", 0.0),
                 floor = NumberOr(holdout, "noise_floor_rms", 0.0);
    if (before > 1.3 * floor && floor > 0) {
      m.calibrated_alone = (before - NumberOr(holdout, "calibrated_rms", before)) / (before - floor);
      m.with_findings = (before - NumberOr(holdout, "after_rms", before)) / (before - floor);
    }
    const double after = NumberOr(holdout, "after_rms", std::nan(""));
    if (floor > 0 && std::isfinite(after)) m.over_floor = after / floor;
    m.verdict_right = Has(Strings(label, "verdict"), m.verdict);
    Marker(label, diagnosis, &m).Run();
    const bool allowed = m.verdict == "unexplained" && m.verdict_right;
    m.first_or_unexplained = allowed ? 1.0 : m.first;
  } catch (const json::exception& e) {
    return InvalidError("label of " + label.value("name", std::string("a case")) + ": " + e.what());
  }
  return m;
}

bool Missed(const CaseMarks& c) {
  return c.first < 1 || c.f1 < 1 || c.false_alarm || !c.joints_exact.value_or(true);
}

const char* KindOfFinding(const std::string& said) {
  const std::string effect = said.substr(0, said.find(' '));
  return effect == kParameters ? "parameters" : OutsideCatalogue(effect) ? "unnamed" : "name";
}

const char* NameOf(CaseKind kind) {
  static constexpr std::array<const char*, kCaseKinds> kNames = {"control", "single",   "pair",
                                                                 "open",    "ordinary", "declared"};
  return kNames[static_cast<size_t>(kind)];
}

}  // namespace rg::proof

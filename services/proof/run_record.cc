#include "services/proof/run_record.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"

namespace rg::proof {

using nlohmann::json;

namespace {

constexpr char kFormat[] = "realitygrad.proof_run/1";
constexpr std::array<const char*, 3> kOutcomes = {"answered", "out_of_time", "failed"};

std::string FileOf(const std::string& answer_folder) { return answer_folder + "/run.json"; }

}  // namespace

bool RunRecord::Settles(const std::string& of_set, double limit) const {
  if (set != of_set || outcome == Outcome::kFailed) return false;
  return outcome == Outcome::kAnswered || (limit > 0 && limit <= limit_s);
}

std::string ToText(const RunRecord& r) {
  return json{{"format", kFormat},    {"set", r.set},
              {"program", r.program}, {"outcome", kOutcomes[static_cast<size_t>(r.outcome)]},
              {"cpu_s", r.cpu_s},     {"limit_s", r.limit_s > 0 ? json(r.limit_s) : json(nullptr)}}
             .dump(1) +
         "\n";
}

std::optional<RunRecord> ReadRunRecord(const std::string& answer_folder) {
  const auto text = ReadFile(FileOf(answer_folder));
  const json j = text.ok() ? json::parse(*text, nullptr, false) : json();
  if (!j.is_object() || j.value("format", json()) != kFormat) return std::nullopt;
  try {
    RunRecord r;
    r.set = j.at("set"), r.program = j.at("program"), r.cpu_s = j.at("cpu_s");
    r.limit_s = j.at("limit_s").is_null() ? 0.0 : j.at("limit_s").get<double>();
    const auto at = std::find(kOutcomes.begin(), kOutcomes.end(), j.at("outcome").get<std::string>());
    if (at == kOutcomes.end()) return std::nullopt;
    r.outcome = static_cast<RunRecord::Outcome>(at - kOutcomes.begin());
    return r;
  } catch (const json::exception&) {
    return std::nullopt;
  }
}

Status WriteRunRecord(const std::string& answer_folder, const RunRecord& record) {
  return WriteFileAtomically(FileOf(answer_folder), ToText(record));
}

}  // namespace rg::proof

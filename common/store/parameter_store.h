// The history of every robot's parameters: what was believed, since when, from which recording, and
// how well it fitted. Versions are never changed or removed.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "common/store/database.h"

namespace rg::store {

// Frozen numbers.
enum class ParameterSource { kNominal = 1, kIdentified = 2, kImported = 3 };
std::string_view ParameterSourceName(ParameterSource source);
Result<ParameterSource> ParseParameterSource(std::string_view name);

struct ParameterValue {
  std::string name;  // "mass.forearm", unique in its version
  double value = 0.0;
  std::optional<double> stddev;  // >= 0
  bool operator==(const ParameterValue&) const = default;
};

struct ParameterVersion {
  int64_t id = 0;
  std::string robot;
  int version = 0;         // 1, 2, ... per robot
  int parent_version = 0;  // 0: none
  ParameterSource source = ParameterSource::kNominal;
  std::string recording_sha256;  // artefact it was identified from; may be empty
  std::string model_sha256;      // model artefact that holds these values; may be empty
  std::optional<double> residual_before;
  std::optional<double> residual_after;
  std::vector<ParameterValue> values;  // empty in History
  int64_t created_ns = 0;
  std::string job_id;
  std::string note;
  std::string rollout = {};  // how it ended, of the recording; may be empty
  bool held_back = false;    // it did not end as asked: the version is current only where it is promoted
};

struct ParameterDiff {
  struct Row {
    std::string name;
    std::optional<double> from;    // absent: new
    std::optional<double> to;      // absent: gone
    std::optional<double> sigmas;  // |to - from| / sqrt(sd_from² + sd_to²), of those that are known
  };
  ParameterVersion from;
  ParameterVersion to;
  std::vector<Row> rows;  // changed ones only, in the order of `to`, then those that are gone
};

class ParameterStore {
 public:
  // The artefacts that versions refer to, for GcOptions::references.
  static constexpr const char* kReferences =
      "SELECT recording_sha256 FROM parameter_version UNION SELECT model_sha256 FROM parameter_version";
  // Refers to the tables of ArtifactStore::Schema(): give that to Database::Open before this one.
  static Module Schema();
  ParameterStore(Database* database, const Clock* clock) : database_(database), clock_(clock) {}

  // Appends a version; id, version and created_ns of the argument are ignored and chosen here.
  // `idempotency_key` (a task's id, say): a repeat with the same key returns the version of the first
  // call; empty: no such check. kInvalid: no values, a value that is not finite, a name twice;
  // kNotFound: parent version or artefact.
  Result<ParameterVersion> Add(const ParameterVersion& version, const std::string& idempotency_key = {});

  Result<std::vector<std::string>> Robots();
  // Newest first, without values. limit 0: all.
  Result<std::vector<ParameterVersion>> History(const std::string& robot, int limit = 0);
  // version 0: the latest.
  Result<ParameterVersion> Show(const std::string& robot, int version = 0);
  Result<ParameterVersion> Latest(const std::string& robot) { return Show(robot, 0); }
  Result<ParameterDiff> Diff(const std::string& robot, int from_version, int to_version);
  // Makes `version` the robot's current one, until another is chosen; 0: from now on the latest that is not held back
  // is current again. kNotFound: no such version.
  Status Promote(const std::string& robot, int version);
  // The version that was chosen, else the latest that is not held back; 0: there is none.
  Result<int> Current(const std::string& robot);

 private:
  Status CheckNew(const ParameterVersion& version);
  Database* database_;
  const Clock* clock_;
};

// [{"name": …, "value": …, "stddev": …}, …] with 17 significant digits.
std::string FormatParameterValues(const std::vector<ParameterValue>& values);
Result<std::vector<ParameterValue>> ParseParameterValues(std::string_view json);
// Pure: what changed between two versions.
ParameterDiff DiffParameters(const ParameterVersion& from, const ParameterVersion& to);

}  // namespace rg::store

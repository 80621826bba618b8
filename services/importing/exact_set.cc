#include "services/importing/exact_set.h"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "services/importing/csv_table.h"

namespace rg::importing {
namespace {

namespace fs = std::filesystem;
using recordings::Recording;

Eigen::VectorXd AsVector(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

// The file of `recording`, column by column.
Status ReadExactly(const std::string& path, Recording* recording, std::vector<std::string>* notes) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  RG_ASSIGN_OR_RETURN(const CsvHeader header, ReadCsvHeader(text, path));
  const auto time = static_cast<size_t>(std::find(header.columns.begin(), header.columns.end(), "time") -
                                        header.columns.begin());
  if (time == header.columns.size()) return InvalidError(path + ": header (line 1): column time is missing");
  std::vector<size_t> wanted;
  for (size_t i = 0; i < header.columns.size(); ++i) {
    if (i != time) wanted.push_back(i);
  }
  RG_ASSIGN_OR_RETURN(const CsvTable table, ReadCsvTable(text, header, path, time, 1e9, wanted));
  Recording exact;
  exact.name = recording->name;
  exact.split = recording->split;
  exact.drive = recording->drive;
  exact.joints = recording->joints;
  exact.t = AsVector(table.time);
  for (size_t i = 0; i < wanted.size(); ++i) {
    const std::string& name = header.columns[wanted[i]];
    if (table.is_text[i]) {
      notes->push_back(path + ": column " + name + " holds text: left out");
    } else {
      exact.other[name] = AsVector(table.columns[i]);
    }
  }
  GatherKinds(&exact);
  *recording = std::move(exact);
  return Status::Ok();
}

}  // namespace

void GatherKinds(Recording* r) {
  const std::pair<const char*, Eigen::MatrixXd*> kinds[] = {{"position", &r->q},
                                                            {"velocity", &r->v},
                                                            {"effort_command", &r->effort_command},
                                                            {"effort_measured", &r->effort_measured}};
  const auto n = static_cast<Eigen::Index>(r->joints.size());
  for (const auto& [kind, matrix] : kinds) {
    const auto name = [&, kind = kind](Eigen::Index i) {
      return std::string(kind) + "." + r->joints[static_cast<size_t>(i)];
    };
    Eigen::MatrixXd all(n, r->rows());
    bool whole = n > 0;
    for (Eigen::Index i = 0; i < n && whole; ++i) {
      const auto column = r->other.find(name(i));
      whole = column != r->other.end() && column->second.allFinite();
      if (whole) all.row(i) = column->second.transpose();
    }
    if (!whole) continue;
    *matrix = std::move(all);
    for (Eigen::Index i = 0; i < n; ++i) r->other.erase(name(i));
  }
}

Result<ExactSet> LoadExactSet(const std::string& folder) {
  ExactSet exact;
  recordings::ReadOptions whole;
  whole.keep_whole = true;
  RG_ASSIGN_OR_RETURN(exact.set, recordings::LoadSet(folder, whole));
  RG_ASSIGN_OR_RETURN(exact.manifest_json, ReadFile((fs::path(folder) / "manifest.json").string()));
  for (Recording& recording : exact.set.recordings) {
    RG_RETURN_IF_ERROR(ReadExactly((fs::path(folder) / recording.name).string(), &recording, &exact.notes));
  }
  return exact;
}

Status WriteExactSet(const std::string& folder, const recordings::RecordingSet& set,
                     const std::string& manifest_json) {
  RG_RETURN_IF_ERROR(recordings::WriteSet(folder, set));
  auto manifest = nlohmann::ordered_json::parse(recordings::FormatManifest(set, "robot.urdf"));
  const auto given = nlohmann::ordered_json::parse(manifest_json, nullptr, false);
  if (!given.is_object()) return Status::Ok();
  for (const auto& [key, value] : given.items()) {
    if (key == "robot" || key == "recordings") continue;  // files have other names here
    manifest[key] = value;
  }
  return WriteFileAtomically((fs::path(folder) / "manifest.json").string(), manifest.dump(1) + "\n");
}

}  // namespace rg::importing

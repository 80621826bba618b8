#include "services/cli/set_arguments.h"

#include <CLI/CLI.hpp>
#include <filesystem>
#include <limits>

#include "common/base/number_text.h"
#include "common/recordings/csv_text.h"
#include "common/recordings/time_stamps.h"

namespace rg::cli {

namespace fs = std::filesystem;

namespace {

// "last third" as a flag without a value.
constexpr const char* kLastThird = "third";

Result<std::optional<double>> SplitTime(const std::string& text) {
  if (text.empty()) return std::optional<double>();
  if (text == kLastThird) return std::optional<double>(std::numeric_limits<double>::infinity());
  double seconds = 0.0;
  if (ParseNumber(text, &seconds) != NumberText::kOk || !(seconds > 0.0))
    return InvalidError("--split-time: '" + text + "', must be a time above 0 (s)");
  return std::optional<double>(seconds);
}

}  // namespace

void ReadArguments::AddTo(CLI::App* command) {
  command->add_option("--time-unit", time_unit,
                      "Of the column time: s, ms, us or ns; default: s, refused where it visibly is not");
  command->add_option("--csv-dialect", dialect,
                      "comma, semicolon or tab between fields; the last two read decimal commas too");
}

Result<recordings::ReadOptions> ReadArguments::Options() const {
  recordings::ReadOptions out;
  if (!time_unit.empty()) {
    RG_ASSIGN_OR_RETURN(out.time_units_per_s, recordings::TimeUnitsPerSecond(time_unit));
  }
  if (!dialect.empty()) {
    RG_ASSIGN_OR_RETURN(out.dialect, recordings::ParseCsvDialect(dialect));
  }
  return out;
}

void SetArguments::AddTo(CLI::App* command) {
  command
      ->add_option(
          "SET", sets,
          "Folder of a recording set, several of one robot are taken as one; or CSV files with --urdf")
      ->required();
  command->add_option("--urdf", urdf, "The robot, where CSV files are given instead of a set");
  command
      ->add_option(
          "--split-time", split_time,
          "A single CSV file: keep what is later than this [s] aside to judge by; default: its last third")
      ->expected(0, 1)
      ->default_str(kLastThird);
  read.AddTo(command);
}

Result<recordings::RecordingSet> SetArguments::Load(bool keep_whole) const {
  RG_ASSIGN_OR_RETURN(recordings::ReadOptions options, read.Options());
  options.keep_whole = keep_whole;
  std::error_code error;
  if (urdf.empty()) {
    for (const std::string& set : sets) {
      if (fs::is_regular_file(set, error))
        return InvalidError(set + ": a file, not a recording set's folder: give the robot with --urdf FILE");
    }
    if (!split_time.empty()) return InvalidError("--split-time is for a single CSV file with --urdf");
    return recordings::LoadSets(sets, options);
  }
  for (const std::string& file : sets) {
    if (fs::is_directory(file, error))
      return InvalidError(file + ": a folder, but --urdf is for CSV files; a recording set names its robot");
  }
  RG_ASSIGN_OR_RETURN(const std::optional<double> split, SplitTime(split_time));
  if (split && sets.size() > 1) return InvalidError("--split-time is for a single CSV file");
  return recordings::SetFromFiles(urdf, sets, split, options);
}

bool SetArguments::is_one_plain_folder() const {
  return sets.size() == 1 && urdf.empty() && read.time_unit.empty() && read.dialect.empty();
}

std::string SetArguments::name() const {
  const fs::path path = fs::path(sets.front()).lexically_normal();
  return (path.has_filename() ? path : path.parent_path()).filename().string();
}

}  // namespace rg::cli

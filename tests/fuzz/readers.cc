#include "tests/fuzz/readers.h"

#include "common/base/check.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/csv.h"
#include "common/recordings/manifest.h"
#include "services/importing/mcap.h"
#include "services/importing/ros1_bag.h"
#include "services/importing/ros2_db3.h"
#include "tests/support/importing/collected_log.h"

namespace rg::fuzz {
namespace {

void CheckOneLine(const Status& status) {
  RG_CHECK(status.message().find('\n') == std::string::npos) << status.message();
}

recordings::CsvOptions TwoJoints() {
  recordings::CsvOptions options;
  options.robot = {{"a", recordings::JointInfo::Type::kRevolute, -3.0, 3.0, 2.0},
                   {"b", recordings::JointInfo::Type::kContinuous}};
  return options;
}

void ReadCsv(std::string_view bytes) {
  static const recordings::CsvOptions options = TwoJoints();
  const auto recording = recordings::ParseCsv(bytes, "fuzz.csv", options);
  CheckOneLine(recording.status());
  recordings::CsvOptions semicolons = options;
  semicolons.dialect = recordings::CsvDialect{';', true};
  CheckOneLine(recordings::ParseCsv(bytes, "fuzz.csv", semicolons).status());
  if (!recording.ok()) return;
  // What was read can be written and read again.
  const auto again = recordings::ParseCsv(recordings::FormatCsv(*recording), "again.csv", options);
  RG_CHECK(!again.ok() || again->rows() == recording->rows());
}

void ReadManifest(std::string_view bytes) {
  CheckOneLine(recordings::ParseManifest(bytes, "manifest.json").status());
}

void ReadUrdf(std::string_view bytes) {
  CheckOneLine(model::ParseUrdf(std::string(bytes), "fuzz.urdf").status());
}

void ReadBag(std::string_view bytes) {
  test::CollectedLog log;
  CheckOneLine(importing::ReadRos1Bag(bytes, "fuzz.bag", log));
}

void ReadMcap(std::string_view bytes) {
  test::CollectedLog log;
  CheckOneLine(importing::ReadMcap(bytes, "fuzz.mcap", log));
}

void ReadDb3(std::string_view bytes) {
  for (const bool compressed : {false, true}) {
    test::CollectedLog log;
    CheckOneLine(importing::ReadDb3Bytes(bytes, "fuzz.db3", compressed, log));
  }
}

}  // namespace

const std::vector<Reader>& Readers() {
  static const std::vector<Reader> readers = {{"csv", ReadCsv}, {"manifest", ReadManifest}, {"urdf", ReadUrdf}, {"bag", ReadBag}, {"mcap", ReadMcap}, {"db3", ReadDb3}};
  return readers;
}

const Reader& ReaderNamed(const std::string& name) {
  for (const Reader& reader : Readers()) {
    if (reader.name == name) return reader;
  }
  RG_CHECK(false) << "no reader " << name;
  return Readers().front();
}

}  // namespace rg::fuzz

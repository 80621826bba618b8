// The header of a recording's CSV file: which columns there are, and of what. What is refused: csv.h.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "common/recordings/csv.h"
#include "common/recordings/csv_text.h"

namespace rg::recordings {

enum class CsvKind { kTime, kPosition, kVelocity, kEffortCommand, kEffortMeasured, kOther };

struct CsvColumn {
  std::string name;
  CsvKind kind = CsvKind::kOther;
  std::string joint;      // of the known kinds
  double* out = nullptr;  // where row 0 goes; null: ignored
  Eigen::Index stride = 1;
  bool is_nameless = false;                   // not read
  bool is_text = false;                       // an other column that holds something else than numbers
  Eigen::Index blanks = 0, first_blank = -1;  // fields that are empty or NaN
  bool first_blank_is_nan = false;
  std::string first_blank_field;
};

struct CsvHeader {
  CsvDialect dialect;
  std::vector<CsvColumn> columns;
  std::vector<std::string> joints;   // wanted, in the order wanted
  std::set<std::string> prescribed;  // of these
  bool has[6] = {};                  // kinds that are there
  std::vector<std::string> notes;

  bool Has(CsvKind kind) const { return has[static_cast<int>(kind)]; }
  CsvColumn* Find(CsvKind kind, const std::string& joint);
};

// `lines` becomes the text behind the header. `ignored`: columns, by name, that are as if they were not
// there.
Result<CsvHeader> ReadCsvHeader(std::string_view text, const std::string& source, const CsvOptions& options,
                                const std::set<std::string>& ignored, std::optional<CsvText>* lines);

}  // namespace rg::recordings

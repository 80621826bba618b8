// What the text of a CSV file that cannot be used looks like, and what to do about it: the ends of csv.h's
// refusals. Nothing here decides whether a file is read.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace rg::recordings {

// Whether a field says that nothing was measured: None, null, N/A, -, ...
bool MeansMissing(std::string_view field);

// "; no thousands separators, ..." for a field that is no number.
std::string WhyNoNumber(std::string_view field);

// For a header without a column time: "; 'stamp' looks like it: name it time, ..."; may be empty.
std::string NoTimeAdvice(const std::vector<std::string>& names);

// For a column position.<joint> or an effort that is missing: the column that it may be, by the joint's name
// and the quantity's usual words ("pos", "q"; "effort", "torque", "tau", ...). `instead` is what to do where
// none looks like it.
std::string MissingColumnAdvice(const std::vector<std::string>& names, const std::string& joint,
                                const std::vector<std::string>& words, const std::string& should_be,
                                const std::string& instead);

// For the name of a joint that the robot lacks: "; is it 'elbow'? ..." or "; it has ...".
std::string UnknownJointAdvice(const std::string& joint, const std::vector<std::string>& known);

}  // namespace rg::recordings

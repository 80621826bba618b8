// Decimal numbers as XML and CSV writers write them, the same in every locale.
//
//   number = blanks [+|-] digits with at most one point [e|E [+|-] digits] blanks
//   blanks = any of space, tab, carriage return, newline; also none
//
// `.9`, `3.`, `4e1`, `+4.0e-3` and ` 2.4E+0 ` are numbers; `1,5`, `0x10`, `1.2.3`, `1e`, `+-1`, `2kg`
// are none. The nearest double is returned. inf and nan (any case) are told from text that is no
// number, so that a caller can refuse them by name. No allocation. Thread-safe.
#pragma once

#include <span>
#include <string>
#include <string_view>

namespace rg {

enum class NumberText {
  kOk,
  kEmpty,       // nothing but blanks
  kNotANumber,  // anything else than a decimal number, or text before or after it
  kOutOfRange,  // a decimal number that no double is near: above 1.8e308 or, not 0, below 2.5e-324
  kNotFinite,   // inf or nan
  kWrongCount,  // ParseNumbers only: more or fewer numbers than asked for
};

// What to say of it after the text: "is not a number"; "is a number" for kOk.
std::string_view NumberTextMessage(NumberText outcome);

// `*value` is written for kOk and kNotFinite (infinite or NaN), else left alone.
NumberText ParseNumber(std::string_view text, double* value);

// Exactly `values.size()` numbers with blanks between them. Outcome of the first that is not kOk;
// kWrongCount where all that are there are numbers. `values` holds all of them for kOk only.
NumberText ParseNumbers(std::string_view text, std::span<double> values);

// The shortest text that ParseNumber reads as `value`, for messages and files.
std::string NumberToText(double value);

}  // namespace rg

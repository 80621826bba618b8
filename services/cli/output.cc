#include "services/cli/output.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <string_view>

#include "common/base/check.h"
#include "common/base/utf8.h"

namespace rg::cli {

ExitCode ExitCodeOf(const Status& status) {
  switch (status.code()) {
    case StatusCode::kOk:
      return kExitOk;
    case StatusCode::kUnavailable:
      return kExitUnreachable;
    case StatusCode::kCancelled:
      return kExitCancelled;
    case StatusCode::kDeadlineExceeded:
      return kExitTimeout;
    default:
      return kExitError;
  }
}

Result<OutputFormat> ParseOutputFormat(std::string_view text) {
  if (text == "table") return OutputFormat::kTable;
  if (text == "json") return OutputFormat::kJson;
  if (text == "quiet") return OutputFormat::kQuiet;
  return InvalidError("--output is '" + std::string(text) + "', must be table, json or quiet");
}

std::vector<double> Numbers(const nlohmann::json& list) {
  std::vector<double> out;
  for (const nlohmann::json& x : list) out.push_back(x.is_number() ? x.get<double>() : std::nan(""));
  return out;
}

int DisplayWidth(std::string_view text) {
  return static_cast<int>(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xC0) != 0x80; }));
}

TextTable::TextTable(std::vector<std::string> columns) {
  for (std::string& name : columns) {
    right_.push_back(name.starts_with('>'));
    columns_.push_back(right_.back() ? name.substr(1) : name);
  }
}

void TextTable::AddRow(std::vector<std::string> cells) {
  RG_CHECK(cells.size() == columns_.size());
  for (std::string& cell : cells) cell = VisibleText(cell);
  rows_.push_back(std::move(cells));
}

std::string TextTable::ToString() const {
  std::vector<int> width;
  for (const auto& name : columns_) width.push_back(DisplayWidth(name));
  for (const auto& row : rows_) {
    for (size_t c = 0; c < row.size(); ++c) width[c] = std::max(width[c], DisplayWidth(row[c]));
  }
  std::string out;
  const auto append = [&](const std::vector<std::string>& row) {
    std::string line;
    for (size_t c = 0; c < row.size(); ++c) {
      const std::string pad(static_cast<size_t>(width[c] - DisplayWidth(row[c])), ' ');
      line += (c ? "  " : "") + (right_[c] ? pad + row[c] : row[c] + pad);
    }
    line.erase(line.find_last_not_of(' ') + 1);
    out += line + "\n";
  };
  append(columns_);
  for (const auto& row : rows_) append(row);
  return out;
}

void PrintJson(std::string_view format, nlohmann::json value) {
  nlohmann::ordered_json out;
  out["format"] = format;
  if (value.is_object()) {
    for (auto& [key, item] : value.items()) out[key] = std::move(item);
  } else {
    out["items"] = std::move(value);
  }
  Print(out.dump(2));
}

namespace {

void WriteLines(std::string_view text, std::FILE* out) {
  const std::string visible = VisibleText(text, true);
  std::fwrite(visible.data(), 1, visible.size(), out);
  if (visible.empty() || visible.back() != '\n') std::fputc('\n', out);
}

bool printed = false;

}  // namespace

void Print(std::string_view text) {
  printed = true;
  WriteLines(text, stdout);
  std::fflush(stdout);
}

bool AnythingPrinted() { return printed; }

void PrintJsonError(const Status& status) {
  PrintJson("realitygrad.error/1", {{"error", status.message()}, {"code", StatusCodeName(status.code())}});
}

void PrintNote(std::string_view text) { WriteLines(text, stderr); }

std::string ShellWord(const std::string& text) {
  const auto plain = [](unsigned char c) {
    return std::isalnum(c) || c >= 0x80 || std::string_view("/._-+:=@%,").find(static_cast<char>(c)) != std::string_view::npos;
  };
  if (!text.empty() && std::all_of(text.begin(), text.end(), plain)) return text;
  std::string out = "'";
  for (const char c : text) out += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return out + "'";
}

int Fail(const Status& status) {
  PrintNote("realitygrad: " + status.ToString());
  return ExitCodeOf(status);
}

std::string FormatSeconds(double seconds) {
  if (!std::isfinite(seconds) || seconds < 0) return "–";
  char text[48];
  if (seconds < 9.95) {
    std::snprintf(text, sizeof text, "%.1f s", seconds);
    return text;
  }
  const long whole = std::lround(seconds);
  if (whole < 60) {
    std::snprintf(text, sizeof text, "%ld s", whole);
  } else if (whole < 3600) {
    std::snprintf(text, sizeof text, "%ld min %02ld s", whole / 60, whole % 60);
  } else {
    std::snprintf(text, sizeof text, "%ld h %02ld min", whole / 3600, whole / 60 % 60);
  }
  return text;
}

}  // namespace rg::cli

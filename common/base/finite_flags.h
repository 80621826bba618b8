// Numbers of a command line: CLI11's ranges let NaN through, which is in none, and infinities are meant by nobody.
// For programs, which link CLI11; this library does not.
#pragma once

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdlib>
#include <string>

namespace rg {

// Throws CLI::ValidationError for a real number that is none, of the app or its subcommands.
inline void CheckFlagsFinite(const CLI::App& app) {
  for (const CLI::Option* option : app.get_options()) {
    if (option->count() == 0 || option->get_type_name().rfind("FLOAT", 0) != 0) continue;
    for (const std::string& text : option->results()) {
      if (!std::isfinite(std::strtod(text.c_str(), nullptr)))
        throw CLI::ValidationError(option->get_name(), "must be a number, not " + text);
    }
  }
  for (const CLI::App* command : app.get_subcommands({})) CheckFlagsFinite(*command);
}

}  // namespace rg

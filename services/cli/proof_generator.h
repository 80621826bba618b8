// The program that makes the sets of `prove`: an engine of its own, built only where DART is, which
// deploy/quickstart does not install.
#pragma once

#include <string>

namespace rg::cli {

inline constexpr char kProofGenerator[] = "realitygrad-proof-generator";

// One line for a shell that installs DART and builds the generator beside this program. Where the folder that
// this program was built in is gone: what to do, in words.
std::string HowToGetProofGenerator();

}  // namespace rg::cli

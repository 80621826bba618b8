// The coordinator program as a function.
#pragma once

namespace rg::coordinator {

// Parses the flags (--help lists them), opens the database, listens, and serves until SIGTERM or
// SIGINT, or until going on would lose something. Prints the bound endpoint on stdout, and writes it to
// --address-file. A changed list of allowed keys takes effect by itself. Exit codes: 0 stopped, 1 error, 2
// usage.
int CoordinatorMain(int argc, char** argv);

}  // namespace rg::coordinator

// The coordinator program as a function.
#pragma once

namespace rg::coordinator {

// Parses the flags (--help lists them), opens the database, listens, and serves until SIGTERM or
// SIGINT. Prints the bound endpoint on stdout, and writes it to --address-file. SIGHUP reads the list
// of allowed keys again. Exit codes: 0 stopped, 1 error, 2 usage.
int CoordinatorMain(int argc, char** argv);

}  // namespace rg::coordinator

// A program of commands, with the flags that all have: realitygrad and realitygrad-lab.
#pragma once

namespace CLI {
class App;
}

namespace rg::cli {

class Context;

// Returns the exit code (output.h). `about`: what its help begins with.
int RunProgram(int argc, char** argv, const char* about, void (*add_commands)(CLI::App&, Context&));

}  // namespace rg::cli

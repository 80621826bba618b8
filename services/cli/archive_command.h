// `jobs archive`.
#pragma once

namespace CLI {
class App;
}

namespace rg::cli {

class Context;

void AddArchiveCommand(CLI::App* jobs, Context& context);

}  // namespace rg::cli

#include "services/cli/proof_generator.h"

#include <unistd.h>

#include <filesystem>

namespace rg::cli {

std::string HowToGetProofGenerator() {
  const std::string source = RG_SOURCE_FOLDER, build = RG_BUILD_FOLDER;
  const std::string packages = "libdart-dev libdart-utils-urdf-dev";
  if (!std::filesystem::exists(source + "/CMakeLists.txt") ||
      !std::filesystem::exists(build + "/CMakeCache.txt"))
    return "install " + packages + " and build RealityGrad again";
  const std::string root = geteuid() == 0 ? "" : "sudo ";
  return root + "apt-get install -y " + packages + " && cmake -S " + source + " -B " + build +
         " && cmake --build " + build + " --target " + kProofGenerator;
}

}  // namespace rg::cli

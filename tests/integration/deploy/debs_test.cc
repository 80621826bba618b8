// The Debian packages: built from the programs of this build, installed into a folder, and used there.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg {
namespace {

namespace fs = std::filesystem;

std::string Variable(const char* name) {
  const char* value = std::getenv(name);
  return value ? value : ".";
}

class Debs : public ::testing::Test {
 protected:
  void SetUp() override {
    for (const char* tool : {"/usr/bin/dh", "/usr/bin/fakeroot", "/usr/bin/dpkg-buildpackage"}) {
      if (access(tool, X_OK) != 0)
        GTEST_SKIP() << tool << " is not installed (packages debhelper, fakeroot, dpkg-dev)";
    }
    if (geteuid() != 0) GTEST_SKIP() << "dpkg installs as root only";
    folder_ = "/tmp/rg-debs-" + RandomHex(6);
    fs::create_directories(folder_ + "/installed/var/lib/dpkg/updates");
    fs::create_directories(folder_ + "/installed/var/lib/dpkg/info");
    ASSERT_TRUE(WriteFileAtomically(folder_ + "/installed/var/lib/dpkg/status", "").ok());
  }
  void TearDown() override {
    std::error_code ignored;
    if (!folder_.empty()) fs::remove_all(folder_, ignored);
  }
  int Run(const std::string& command) {
    const int how = std::system((command + " > " + folder_ + "/said 2>&1").c_str());
    return WIFEXITED(how) ? WEXITSTATUS(how) : -1;
  }
  std::string Said() const { return *ReadFile(folder_ + "/said"); }
  std::string folder_;
};

TEST_F(Debs, AreBuiltInstalledAndUsed) {
  ASSERT_EQ(Run(Variable("RG_SOURCE_DIR") + "/deploy/build-debs --output " + folder_ + "/debs --bin " +
                Variable("RG_BIN_DIR")),
            0)
      << Said();
  ASSERT_EQ(Run("dpkg --root=" + folder_ + "/installed --force-depends --force-script-chrootless -i " + folder_ +
                "/debs/*.deb"),
            0)
      << Said();
  const std::string root = folder_ + "/installed";
  for (const char* file :
       {"/usr/bin/realitygrad", "/usr/bin/realitygrad-lab", "/usr/bin/realitygrad-coordinator",
        "/usr/bin/realitygrad-worker", "/usr/bin/realitygrad-agent", "/usr/bin/realitygrad-guard",
        "/lib/systemd/system/realitygrad-coordinator.service",
        "/lib/systemd/system/realitygrad-worker.service", "/lib/systemd/system/realitygrad-agent.service",
        "/usr/share/bash-completion/completions/realitygrad", "/usr/share/realitygrad/robots/mico2.urdf",
        "/etc/realitygrad/coordinator.env"})
    EXPECT_TRUE(fs::exists(root + file)) << file;
  // The user of the units, in the folder and not on this machine.
  EXPECT_NE(ReadFile(root + "/etc/passwd").value().find("realitygrad:x:64100:"), std::string::npos);

  // The robots of the package, not those of the source tree.
  ASSERT_EQ(Run(root + "/usr/bin/realitygrad doctor"), 0) << Said();
  EXPECT_NE(Said().find(root + "/usr/share/realitygrad/robots"), std::string::npos) << Said();
  // Installed programs find each other.
  ASSERT_EQ(Run("cd " + folder_ + " && " + root + "/usr/bin/realitygrad coordinator --help"), 0) << Said();

  ASSERT_EQ(Run("dpkg --root=" + root +
                " --force-depends --force-script-chrootless --purge realitygrad realitygrad-agent"),
            0)
      << Said();
  EXPECT_FALSE(fs::exists(root + "/usr/bin/realitygrad"));
}

}  // namespace
}  // namespace rg

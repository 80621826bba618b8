// A recording of a hundred megabytes, made here: what a user does with it first takes less than 2 GB, and a diagnosis
// says how far it is and can be stopped.
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstring>
#include <thread>

#include "common/recordings/csv.h"
#include "tests/integration/cli/program.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg {
namespace {

constexpr double kMostBytes = 2e9;
constexpr auto kPatience = std::chrono::minutes(20);

// arm2 at 1 kHz, its file's size in bytes.
size_t MakeBigRecording(const std::string& path) {
  const sim::Plant arm = sysid::testing::LoadPlant("arm2");
  sysid::testing::MakeOptions make;
  make.duration_s = 1100, make.rate_hz = 1000, make.amplitude = 1.0;
  make.position_noise = 5e-4, make.velocity_noise = 8e-3;
  recordings::Recording made = sysid::testing::MakeRecording(arm, arm.parameters().Nominal(), 5, make);
  made.joints = arm.joint_names();
  const std::string csv = recordings::FormatCsv(made);
  EXPECT_TRUE(WriteFileAtomically(path, csv).ok());
  return csv.size();
}

struct Ended {
  int status = 0;
  double bytes = 0;  // most of its memory at a time
};

class Program {
 public:
  Program(const ScratchFolder& scratch, const std::vector<std::string>& arguments) : err_(scratch / "err") {
    std::vector<std::string> words = {BinDir() + "/realitygrad"};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    const std::string out = scratch / "out";
    child_ = ::fork();
    if (child_ == 0) {
      if (std::freopen(out.c_str(), "w", stdout) && std::freopen(err_.c_str(), "w", stderr)) ::execv(argv[0], argv.data());
      ::_exit(127);
    }
  }
  // Until it says `text`; false where it ended before, or has not within kPatience.
  bool WaitsToSay(const char* text) {
    const auto until = std::chrono::steady_clock::now() + kPatience;
    while (std::chrono::steady_clock::now() < until && ::waitid(P_PID, static_cast<id_t>(child_), &info_, WEXITED | WNOHANG | WNOWAIT) == 0 &&
           info_.si_pid == 0) {
      if (Said().find(text) != std::string::npos) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    return false;
  }
  std::string Said() const { return ReadFile(err_).ok() ? *ReadFile(err_) : ""; }
  void Interrupt() const { ::kill(child_, SIGINT); }
  Ended End() {
    Ended out;
    rusage used{};
    EXPECT_EQ(::wait4(child_, &out.status, 0, &used), child_);
    out.bytes = 1024.0 * static_cast<double>(used.ru_maxrss);
    return out;
  }

 private:
  std::string err_;
  pid_t child_ = -1;
  siginfo_t info_{};
};

TEST(BigRecording, IsCheckedImportedAndDiagnosedInLessThanTwoGigabytes) {
  const ScratchFolder scratch;
  const std::string csv = scratch / "big.csv", robot = sysid::testing::RobotPath("arm2");
  ASSERT_GT(MakeBigRecording(csv), 100'000'000u);
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{"check", "--urdf", robot, csv, "--split-time"},
        {"import", csv, "--urdf", robot, "--out", scratch / "set"}}) {
    Program program(scratch, arguments);
    const Ended ended = program.End();
    EXPECT_EQ(ended.status, 0) << program.Said();
    EXPECT_LT(ended.bytes, kMostBytes) << arguments[0];
    RecordProperty(arguments[0] + "_megabytes", static_cast<int>(ended.bytes / 1e6));
  }
  Program diagnose(scratch, {"diagnose", "--urdf", robot, csv, "--split-time", "--out", scratch / "out_of_it"});
  // The first stage fits, which all others are like in memory.
  EXPECT_TRUE(diagnose.WaitsToSay("calibrate")) << diagnose.Said();
  std::this_thread::sleep_for(std::chrono::seconds(30));
  diagnose.Interrupt();
  const Ended ended = diagnose.End();
  EXPECT_TRUE(WIFEXITED(ended.status)) << "it does not die of the interrupt";
  EXPECT_LT(ended.bytes, kMostBytes);
  RecordProperty("diagnose_megabytes", static_cast<int>(ended.bytes / 1e6));
  std::printf("diagnose: %.0f MB\n", ended.bytes / 1e6);
}

}  // namespace
}  // namespace rg

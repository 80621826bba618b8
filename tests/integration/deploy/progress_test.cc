// deploy/progress.sh: how much of a build is done and how long the rest takes, of builds that are made up
// here on a clock that the lines themselves set.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/base/rng.h"

namespace rg {
namespace {

constexpr int kCores = 2;

struct Job {
  std::string target;
  double seconds;
};

std::string Description(const Job& job) {
  return "Building CXX object room/CMakeFiles/" + job.target + ".dir/file.cc.o";
}

std::string Plan(const std::vector<Job>& jobs) {
  std::string plan;
  for (const Job& job : jobs) plan += "[1/9] " + Description(job) + "\n";
  return plan;
}

struct Line {
  double stamp_s;
  std::string text;
};

// What ninja says of the jobs on kCores cores, each begun in turn.
std::vector<Line> Build(const std::vector<Job>& jobs) {
  std::vector<double> free(kCores, 0.0);
  std::vector<Line> lines;
  for (const Job& job : jobs) {
    double& core = *std::min_element(free.begin(), free.end());
    core += job.seconds;
    lines.push_back({core, "[1/9] " + Description(job)});
  }
  std::stable_sort(lines.begin(), lines.end(),
                   [](const Line& a, const Line& b) { return a.stamp_s < b.stamp_s; });
  return lines;
}

struct Shown {
  double stamp_s;
  int percent;
  double left_s;
};

class Progress : public testing::Test {
 protected:
  Progress() : folder_(std::filesystem::temp_directory_path() / ("rg_progress_" + RandomHex(6))) {
    std::filesystem::create_directories(folder_);
  }
  ~Progress() override { std::filesystem::remove_all(folder_); }

  // Stderr of show_progress; every line of the build is preceded by `@seconds`.
  std::string Show(const std::string& costs, const std::vector<Job>& jobs, const std::vector<Line>& lines) {
    std::string said;
    for (const Line& line : lines)
      said += std::to_string(std::lround(line.stamp_s * 1000)) + " " + line.text + "\n";
    Write("costs", costs), Write("plan", Plan(jobs)), Write("said", said);
    Write("script", "source " + Source() +
                        "/deploy/progress.sh\n"
                        "cd " +
                        folder_.string() +
                        "\ncosts_file=costs\nclock=0\n"
                        "now_ms() { echo $clock; }\n"
                        "next_line() { local t; read -r t \"$1\" || return 1; clock=$t; echo \"@$t\" >&2; }\n"
                        "show_progress building \"$(cat plan)\" " +
                        std::to_string(kCores) + " <said 2>shown\n");
    EXPECT_EQ(std::system(("bash " + (folder_ / "script").string()).c_str()), 0);
    return ReadFile(folder_ / "shown").value();
  }

  static std::vector<Shown> Parse(const std::string& text) {
    std::vector<Shown> all;
    std::istringstream in(text);
    double now = 0.0;
    for (std::string line; std::getline(in, line);) {
      int percent = 0, minutes = 0, seconds = 0;
      if (line[0] == '@') now = 1e-3 * std::stod(line.substr(1));
      if (std::sscanf(line.c_str(), "building: %d %%, about %d min %d s left", &percent, &minutes,
                      &seconds) == 3) {
        all.push_back({now, percent, 60.0 * minutes + seconds});
      } else if (std::sscanf(line.c_str(), "building: %d %%, about %d s left", &percent, &seconds) == 2) {
        all.push_back({now, percent, 1.0 * seconds});
      }
    }
    return all;
  }

  // From a fifth on until little is left.
  void ExpectRightWithinFactorTwo(const std::string& costs, const std::vector<Job>& jobs) {
    const std::vector<Line> lines = Build(jobs);
    const double end = lines.back().stamp_s;
    const std::vector<Shown> shown = Parse(Show(costs, jobs, lines));
    EXPECT_GE(shown.size(), 5u);
    EXPECT_LE(shown.size(), 10u);
    for (const Shown& s : shown) {
      const double left = end - s.stamp_s;
      if (s.percent < 20 || left < 0.05 * end) continue;
      EXPECT_GT(s.left_s, left / 2 - 1) << "at " << s.percent << " %";
      EXPECT_LT(s.left_s, left * 2 + 1) << "at " << s.percent << " %";
    }
  }

  static std::string Source() {
    const char* dir = std::getenv("RG_SOURCE_DIR");
    return dir ? dir : std::filesystem::current_path().string();
  }
  void Write(const std::string& name, const std::string& text) {
    ASSERT_TRUE(WriteFileAtomically((folder_ / name).string(), text).ok());
  }

  std::filesystem::path folder_;
};

// Light jobs with a few heavy ones among them, at `pace` times what the costs say.
std::vector<Job> SomeJobs(double pace, size_t heavy_at) {
  Rng rng(7);
  std::vector<Job> jobs;
  for (int i = 0; i < 80; ++i) jobs.push_back({"light", pace * rng.Uniform(1.0, 7.0)});
  jobs.insert(jobs.begin() + static_cast<std::ptrdiff_t>(heavy_at), 4, {"heavy", pace * 40.0});
  return jobs;
}

TEST_F(Progress, TimeLeftIsRightWithinFactorTwoFromAFifthOn) {
  const std::string costs = "# seconds\n4 other\n40 heavy\n";
  for (const double pace : {0.3, 1.0, 4.0}) {
    for (const size_t heavy_at : {0, 40, 80}) {
      SCOPED_TRACE(testing::Message() << "pace " << pace << ", heavy ones after " << heavy_at);
      ExpectRightWithinFactorTwo(costs, SomeJobs(pace, heavy_at));
    }
  }
}

TEST_F(Progress, ALineEveryTenthAndTheWholeTimeAtTheEnd) {
  const std::vector<Job> jobs(50, {"light", 4.0});
  const std::string text = Show("4 other\n", jobs, Build(jobs));
  EXPECT_EQ(Parse(text).size(), 9u) << text;
  EXPECT_THAT(text, testing::EndsWith("building: took 1 min 40 s\n"));
}

TEST_F(Progress, WhatTheCompilerSaysIsPassedOn) {
  const std::vector<Job> jobs(3, {"light", 4.0});
  std::vector<Line> lines = Build(jobs);
  lines.insert(lines.begin() + 1, {5.0, "FAILED: room/file.cc.o"});
  lines.push_back({9.0, "ninja: build stopped: subcommand failed."});
  const std::string text = Show("4 other\n", jobs, lines);
  EXPECT_THAT(text, testing::HasSubstr("\nFAILED: room/file.cc.o\n"));
  EXPECT_THAT(text, testing::HasSubstr("\nninja: build stopped: subcommand failed.\n"));
  EXPECT_THAT(text, testing::Not(testing::HasSubstr("[1/9]")));
}

TEST_F(Progress, NothingToDoSaysNothing) {
  EXPECT_EQ(Show("4 other\n", {}, {{0.1, "ninja: no work to do."}}), "@100\n");
}

// A build of four jobs whose CMake looks for new files first, as this project's does.
TEST_F(Progress, ThePlanHasTheJobsBehindTheGlobs) {
  Write("CMakeLists.txt", R"(cmake_minimum_required(VERSION 3.25)
project(plan NONE)
file(GLOB found CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/*.in)
foreach(job 1 2 3 4)
  add_custom_command(OUTPUT ${job}.out COMMAND ${CMAKE_COMMAND} -E touch ${job}.out COMMENT "job ${job}")
  list(APPEND all ${job}.out)
endforeach()
add_custom_target(everything ALL DEPENDS ${all})
)");
  const std::string build = (folder_ / "build").string();
  const std::string script = "cmake -G Ninja -S " + folder_.string() + " -B " + build + " >/dev/null && source " + Source() +
                             "/deploy/progress.sh && build_plan " + build + " >" + (folder_ / "planned").string();
  ASSERT_EQ(std::system(("bash -c '" + script + "'").c_str()), 0);
  const std::string planned = ReadFile(folder_ / "planned").value();
  for (const char* job : {"job 1\n", "job 2\n", "job 3\n", "job 4\n"}) EXPECT_THAT(planned, testing::HasSubstr(job));
}

// Every name in deploy/build_costs is a target of this build.
TEST_F(Progress, CostsNameTargetsThatExist) {
  const char* bin = std::getenv("RG_BIN_DIR");
  ASSERT_NE(bin, nullptr);
  const std::string rules = ReadFile(std::string(bin) + "/../build.ninja").value();
  std::istringstream in(ReadFile(Source() + "/deploy/build_costs").value());
  int named = 0;
  for (std::string line; std::getline(in, line);) {
    if (line.empty() || line[0] == '#') continue;
    const std::string target = line.substr(line.find(' ') + 1);
    ++named;
    if (target == "other" || target.find("proof-generator") != std::string::npos) continue;
    EXPECT_NE(rules.find("CMakeFiles/" + target + ".dir/"), std::string::npos) << line;
  }
  EXPECT_GT(named, 3);
}

}  // namespace
}  // namespace rg

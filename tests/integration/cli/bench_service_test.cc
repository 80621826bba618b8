// `bench service` with its own programs, small; and `jobs archive`.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/integration/cli/program.h"
#include "tests/support/service/processes.h"

namespace rg {
namespace {

using nlohmann::json;
namespace pb = realitygrad::v1;

TEST(BenchService, MeasuresAndSaysWhat) {
  const ScratchFolder scratch;
  const Said said = RunProgram(
      scratch,
      "bench service --quick --workers 20 --only dispatch_p99_ms,restart_1m_s,workers,archived_bytes_per_task --output json");
  ASSERT_EQ(said.code, 0) << said.err;
  const json figures = json::parse(said.out, nullptr, false);
  ASSERT_TRUE(figures.is_object()) << said.out;
  EXPECT_EQ(figures.at("workers"), 20) << figures.at("notes");
  for (const char* key : {"dispatch_p99_ms", "restart_1m_s"}) {
    ASSERT_TRUE(figures.at(key).is_number()) << figures.at("notes").at(key);
    EXPECT_GT(figures.at(key).get<double>(), 0.0);
    EXPECT_FALSE(figures.at("notes").at(key).get<std::string>().empty());
  }
  EXPECT_EQ(figures.at("targets").at("dispatch_p99_ms"), json({{"at_most", 50.0}}));
  ASSERT_TRUE(figures.at("archived_bytes_per_task").is_number())
      << figures.at("notes").at("archived_bytes_per_task");
  EXPECT_GT(figures.at("archived_bytes_per_task"), 1'000.0) << "each has a result of 1 KiB";
  EXPECT_FALSE(figures.contains("tasks_per_s")) << "not asked for";
}

TEST(BenchService, RefusesAnUnknownKeyByName) {
  const ScratchFolder scratch;
  const Said said = RunProgram(scratch, "bench service --only warp");
  EXPECT_NE(said.code, 0);
  EXPECT_NE(said.err.find("'warp'"), std::string::npos) << said.err;
}

TEST(JobsArchive, SaysWhatItWouldDoAndDoesItWithYes) {
  const ScratchFolder scratch;
  testing::Service service;
  pb::JobSpec job;
  testing::AddTask(&job, "t", "echo");
  ASSERT_TRUE(service.client().Submit(job).ok());
  ASSERT_TRUE(service.client().Act(1, pb::JOB_ACTION_CANCEL).ok());
  const auto run = [&](const std::string& arguments) {
    const Said said = RunProgram(scratch, "--coordinator " + service.endpoint() + " " + arguments);
    EXPECT_EQ(said.code, 0) << said.err;
    return said.out;
  };
  EXPECT_NE(run("jobs archive --older-than-days 0").find("would archive 1 jobs"), std::string::npos);
  EXPECT_EQ(service.client().GetJob(1)->job().archived_ns(), 0);
  EXPECT_NE(run("jobs archive --older-than-days 0 --yes").find("archived 1 jobs"), std::string::npos);
  EXPECT_GT(service.client().GetJob(1)->job().archived_ns(), 0);
  EXPECT_NE(run("jobs").find("cancelled"), std::string::npos);
}

}  // namespace
}  // namespace rg

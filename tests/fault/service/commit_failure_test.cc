// A disk that takes nothing: reads go on, nobody is told what was not kept, everybody is told why, nothing
// is lost, and it recovers by itself. A disk that may have lost something ends the coordinator.
#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/mount.h>

#include <filesystem>
#include <fstream>

#include "common/base/ids.h"
#include "tests/support/fault_vfs/fault_vfs.h"
#include "tests/support/service/server_bench.h"

namespace rg::testing {
namespace {

class FullDisk : public ::testing::Test {
 protected:
  FullDisk()
      : client_(bench_.Connect("client", pb::ROLE_OPERATOR)),
        worker_(bench_.Connect("w1", pb::ROLE_WORKER)) {}

  void FailCommits(const Status& with) {
    bench_.server_->database().set_write_hook([with](store::WriteKind kind, std::string_view) {
      return kind == store::WriteKind::kCommit ? with : Status::Ok();
    });
  }
  void Fill() { FailCommits(ResourceExhaustedError("no space left")); }
  void MakeRoom() { FailCommits(Status::Ok()); }
  Status Turn() { return bench_.Turn(); }
  // Until it has looked whether there is room.
  void WaitForRecovery() {
    bench_.Pass(1.1);
    ASSERT_TRUE(Turn().ok());
  }
  std::string Trouble() {
    client_->Ask(pb::StatusRequest());
    EXPECT_TRUE(Turn().ok());
    const auto status = client_->Reply<pb::StatusReply>();
    EXPECT_TRUE(status.ok()) << status.status().ToString();
    return status.ok() ? status->trouble() : "";
  }
  // The worker has joined and holds the only task of job 1.
  pb::TaskAssignment Begin() {
    client_->Submit(OneTask(), "r1");
    worker_->Hello({"echo"});
    EXPECT_TRUE(Turn().ok());
    EXPECT_TRUE(client_->Reply<pb::SubmitReply>().ok());
    const auto assignment = AssignmentIn(worker_->Mail());
    EXPECT_NE(assignment.token(), 0u);
    return assignment;
  }

  ServerBench bench_;
  std::unique_ptr<Peer> client_, worker_;
};

TEST_F(FullDisk, ASubmitThatWasNotKeptIsRefusedWithTheReasonAndTakenLater) {
  Fill();
  client_->Submit(OneTask(), "r1");
  ASSERT_TRUE(Turn().ok());
  const auto refused = client_->Reply<pb::SubmitReply>();
  EXPECT_EQ(refused.status().code(), StatusCode::kResourceExhausted);
  EXPECT_EQ(refused.status().message(), "disk full: no space left");
  EXPECT_TRUE(bench_.state().jobs.empty());
  MakeRoom();
  WaitForRecovery();
  client_->Submit(OneTask(), "r1");
  ASSERT_TRUE(Turn().ok());
  EXPECT_EQ(client_->Reply<pb::SubmitReply>()->job(), 1);
}

TEST_F(FullDisk, ReadsGoOnAndEveryChangeIsRefused) {
  Begin();
  Fill();
  client_->Submit(OneTask(), "r2");
  ASSERT_TRUE(Turn().ok());
  client_->Reply<pb::SubmitReply>().status().ok();
  for (int i = 0; i < 3; ++i) {
    client_->Ask(pb::ListJobsRequest());
    client_->Submit(OneTask(), "r3");
    pb::JobActionRequest cancel;
    cancel.set_job(1);
    cancel.set_action(pb::JOB_ACTION_CANCEL);
    client_->Ask(cancel);
    pb::PutArtifactRequest put;
    put.set_upload_id("u");
    client_->Ask(put);
    ASSERT_TRUE(Turn().ok());
    int refused = 0, read = 0;
    for (int reply = 0; reply < 4; ++reply) {
      const auto got = client_->Reply<pb::ListJobsReply>();
      refused += got.status().code() == StatusCode::kResourceExhausted;
      read += got.ok() && got->jobs_size() == 1;
    }
    EXPECT_EQ(refused, 3);
    EXPECT_EQ(read, 1);
  }
  EXPECT_EQ(Trouble(), "disk full: no space left");
  EXPECT_EQ(bench_.state().jobs.at(1).record.phase, coordinator::JobPhase::kRunning);
}

// A disk that is really full: what ends work or frees space is done from the reserve, which is kept again later.
TEST(FullDiskReserve, CancelsArchivesAndCollectsWhereNothingElseIsTaken) {
  const std::string folder = "/tmp/rg-full-" + RandomHex(6);
  std::filesystem::create_directories(folder);
  if (::mount("tmpfs", folder.c_str(), "tmpfs", 0, "size=32m") != 0) GTEST_SKIP() << "cannot mount a small disk here";
  {
    coordinator::ServerOptions options;
    options.database_path = folder + "/a.db";
    ServerBench bench(options);
    const auto client = bench.Connect("client", pb::ROLE_OPERATOR);
    for (int i = 1; i <= 3; ++i) client->Submit(OneTask(), "r" + std::to_string(i));
    ASSERT_TRUE(bench.Turn().ok());
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(client->Reply<pb::SubmitReply>().ok());
    const std::string filler = folder + "/filler";
    {
      std::ofstream out(filler, std::ios::binary);
      const std::string piece(1 << 12, 'x');
      while (out.write(piece.data(), static_cast<std::streamsize>(piece.size())).flush()) {
      }
    }
    pb::JobSpec large = OneTask();
    large.mutable_tasks(0)->set_payload(std::string(4 << 20, 'x'));
    client->Submit(large, "large");
    ASSERT_TRUE(bench.Turn().ok());
    EXPECT_EQ(client->Reply<pb::SubmitReply>().status().code(), StatusCode::kResourceExhausted);
    pb::JobActionRequest cancel;
    cancel.set_job(2);
    cancel.set_action(pb::JOB_ACTION_CANCEL);
    client->Ask(cancel);
    ASSERT_TRUE(bench.Turn().ok());
    const auto cancelled = client->Reply<pb::JobActionReply>();
    ASSERT_TRUE(cancelled.ok()) << cancelled.status().ToString();
    EXPECT_EQ(cancelled->job().state(), pb::JOB_STATE_CANCELLED);
    client->Submit(OneTask(), "r4");
    client->Ask(pb::ArchiveJobsRequest());
    client->Ask(pb::GcArtifactsRequest());
    ASSERT_TRUE(bench.Turn().ok());
    const auto archived = client->Reply<pb::ArchiveJobsReply>();
    EXPECT_EQ(archived.status().code(), StatusCode::kResourceExhausted) << "the reply to the submit: not from the reserve";
    EXPECT_TRUE(client->Reply<pb::ArchiveJobsReply>().ok());
    EXPECT_TRUE(client->Reply<pb::GcArtifactsReply>().ok());
    bench.Pass(1.1);
    ASSERT_TRUE(bench.Turn().ok());
    client->Ask(pb::StatusRequest());
    ASSERT_TRUE(bench.Turn().ok());
    EXPECT_EQ(client->Reply<pb::StatusReply>()->trouble().rfind("disk full", 0), 0u) << "the reserve's room is no room";
    std::filesystem::remove(filler);
    bench.Pass(31.0);
    ASSERT_TRUE(bench.Turn().ok());
    client->Submit(OneTask(), "r5");
    ASSERT_TRUE(bench.Turn().ok());
    EXPECT_TRUE(client->Reply<pb::SubmitReply>().ok());
    EXPECT_TRUE(std::filesystem::exists(options.database_path + ".reserve"));
  }
  ::umount2(folder.c_str(), MNT_DETACH);
  std::filesystem::remove_all(folder);
}

TEST_F(FullDisk, AResultStaysWithItsWorkerUntilThereIsRoom) {
  const auto assignment = Begin();
  Fill();
  for (int i = 0; i < 2; ++i) {  // the batch that fails, and one that is put off
    worker_->Tell(FinishedMessage(assignment));
    ASSERT_TRUE(Turn().ok());
    const auto mail = worker_->Mail();
    ASSERT_EQ(mail.size(), 1u);
    EXPECT_TRUE(mail[0].result_reply().try_again());
    EXPECT_FALSE(mail[0].result_reply().accepted());
    EXPECT_EQ(mail[0].result_reply().reason(), "disk full: no space left");
  }
  MakeRoom();
  WaitForRecovery();
  worker_->Mail();
  worker_->Tell(FinishedMessage(assignment));
  ASSERT_TRUE(Turn().ok());
  const auto mail = worker_->Mail();
  ASSERT_EQ(mail.size(), 1u);
  EXPECT_TRUE(mail[0].result_reply().accepted());
  EXPECT_TRUE(bench_.state().jobs.empty()) << "it is over";
  EXPECT_EQ(Trouble(), "");
}

TEST_F(FullDisk, WhatCameToNothingIsNotCounted) {
  const auto assignment = Begin();
  Fill();
  worker_->Tell(FinishedMessage(assignment));
  ASSERT_TRUE(Turn().ok());
  worker_->Mail();
  const auto counted = [&] {
    client_->Ask(pb::StatusRequest());
    client_->Ask(pb::ListWorkersRequest());
    EXPECT_TRUE(Turn().ok());
    const auto status = client_->Reply<pb::StatusReply>();
    const auto workers = client_->Reply<pb::ListWorkersReply>();
    EXPECT_TRUE(status.ok() && workers.ok());
    const auto& counters = status->counters();
    return std::vector<double>{counters.at("jobs_submitted_total"), counters.at("jobs_succeeded_total"),
                               counters.at("tasks_committed_total"), counters.at("attempts_started_total"),
                               static_cast<double>(workers->workers(0).tasks_done())};
  };
  EXPECT_EQ(counted(), (std::vector<double>{1, 0, 0, 1, 0}));
  MakeRoom();
  WaitForRecovery();
  worker_->Tell(FinishedMessage(assignment));
  ASSERT_TRUE(Turn().ok());
  EXPECT_EQ(counted(), (std::vector<double>{1, 1, 1, 1, 1}));
}

TEST_F(FullDisk, WorkersAndLeasesOutliveItHoweverLongItLasts) {
  const auto assignment = Begin();
  Fill();
  client_->Submit(OneTask(), "r2");
  ASSERT_TRUE(Turn().ok());
  for (int i = 0; i < 30; ++i) {  // ten leases long
    bench_.Pass(1.3);
    worker_->Beat({assignment.token()});
    ASSERT_TRUE(Turn().ok());
    for (const auto& mail : worker_->Mail()) {
      EXPECT_TRUE(mail.heartbeat_reply().known());
      EXPECT_EQ(mail.heartbeat_reply().trouble(), "disk full: no space left");
    }
  }
  MakeRoom();
  bench_.Pass(40.0);  // it asks less and less often
  worker_->Beat({assignment.token()});
  ASSERT_TRUE(Turn().ok());
  worker_->Beat({assignment.token()});
  ASSERT_TRUE(Turn().ok());
  bench_.Pass(2.5);
  worker_->Beat({assignment.token()});
  ASSERT_TRUE(Turn().ok());
  EXPECT_EQ(bench_.state().counters.workers_lost, 0u);
  EXPECT_EQ(bench_.state().counters.attempts_lost, 0u);
  EXPECT_EQ(bench_.state().leases.count(assignment.token()), 1u);
}

TEST_F(FullDisk, NoAssignmentLeavesBeforeItIsKeptAndWhatWaitsIsGivenOutAfterwards) {
  worker_->Hello({"echo"});
  pb::JobSpec waits = OneTask();
  client_->Submit(waits, "r1");
  Fill();
  ASSERT_TRUE(Turn().ok());
  EXPECT_EQ(AssignmentIn(worker_->Mail()).token(), 0u);
  MakeRoom();
  WaitForRecovery();
  client_->Submit(waits, "r1");
  ASSERT_TRUE(Turn().ok());
  worker_->Hello({"echo"});  // it says so until it is welcome
  ASSERT_TRUE(Turn().ok());
  EXPECT_NE(AssignmentIn(worker_->Mail()).token(), 0u);
}

TEST_F(FullDisk, AnFsyncThatFailedEndsTheCoordinator) {
  client_->Submit(OneTask(), "r1");
  FailCommits(InternalError("disk I/O error"));
  const Status end = Turn();
  EXPECT_EQ(end.code(), StatusCode::kInternal);
  EXPECT_EQ(end.message(), "a change could not be made durable: disk I/O error");
  EXPECT_EQ(client_->Reply<pb::SubmitReply>().status().message(), "no reply");
}

TEST_F(FullDisk, AStateThatCannotBeReadBackEndsTheCoordinator) {
  Begin();
  ASSERT_TRUE(bench_.server_->database().Execute("UPDATE jobs SET tags_json = 'no list'").ok());
  Fill();
  client_->Submit(OneTask(), "r2");
  const Status end = Turn();
  EXPECT_EQ(end.code(), StatusCode::kDataLoss);
  EXPECT_NE(end.message().find("disk full: no space left, and the state cannot be read back"),
            std::string::npos)
      << end.message();
}

// SQLite itself meets the full disk, at every one of its writes in turn.
TEST(DiskFull, AtAnyWriteEverySubmitIsEitherKeptOrRefused) {
  constexpr int kWrites = 40;
  int refused = 0;
  for (int nth = 1; nth <= kWrites; ++nth) {
    testing_support::FaultVfs vfs;
    const std::string folder = "/tmp/rg-full-" + RandomHex(6);
    std::filesystem::create_directories(folder);
    coordinator::ServerOptions options;
    options.database_path = folder + "/service.db";
    options.vfs = vfs.name();
    {
      ServerBench bench(options);
      const auto client = bench.Connect("client", pb::ROLE_OPERATOR);
      vfs.FailAt(nth, SQLITE_FULL, 3);
      std::set<std::string> kept;
      for (int i = 0; i < 12; ++i) {
        const std::string id = "r" + std::to_string(i);
        client->Submit(OneTask(), id);
        ASSERT_TRUE(bench.Turn().ok());
        const auto reply = client->Reply<pb::SubmitReply>();
        if (reply.ok()) {
          kept.insert(id);
        } else {
          ++refused;
          EXPECT_EQ(reply.status().code(), StatusCode::kResourceExhausted);
          EXPECT_EQ(reply.status().message().rfind("disk full", 0), 0u) << reply.status().message();
        }
        bench.Pass(1.1);
      }
      EXPECT_GE(kept.size(), 8u) << "it recovers";
      EXPECT_EQ(bench.state().jobs.size(), kept.size());
      bench.server_.reset();
      const auto again = coordinator::Server::Open(options, bench.network_.Bind("d"),
                                                   {"d", pb::ROLE_COORDINATOR}, &bench.clock_);
      ASSERT_TRUE(again.ok()) << again.status().ToString();
      for (const std::string& id : kept) EXPECT_EQ((*again)->state().job_by_request.count(id), 1u) << id;
      EXPECT_EQ((*again)->state().jobs.size(), kept.size());
    }
    std::filesystem::remove_all(folder);
  }
  EXPECT_GT(refused, 5);
}

TEST(DiskFull, AnFsyncErrorOfTheDiskEndsTheCoordinatorInOneLine) {
  testing_support::FaultVfs vfs;
  const std::string folder = "/tmp/rg-fsync-" + RandomHex(6);
  std::filesystem::create_directories(folder);
  coordinator::ServerOptions options;
  options.database_path = folder + "/service.db";
  options.vfs = vfs.name();
  ServerBench bench(options);
  const auto client = bench.Connect("client", pb::ROLE_OPERATOR);
  vfs.FailAt(1, SQLITE_IOERR_FSYNC, 1000);
  client->Submit(OneTask(), "r");
  const Status end = bench.Turn();
  EXPECT_EQ(end.code(), StatusCode::kInternal);
  EXPECT_EQ(end.message().find('\n'), std::string::npos);
  EXPECT_EQ(end.message().rfind("a change could not be made durable", 0), 0u) << end.message();
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace rg::testing

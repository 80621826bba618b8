#include "services/lab/service_bench.h"

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <map>
#include <thread>

#include "common/base/clock.h"
#include "common/base/printf.h"
#include "common/base/rng.h"
#include "coordinator/client/client.h"
#include "services/jobs/kinds.h"
#include "services/lab/service_rig.h"
#include "services/lab/simulated_workers.h"

namespace rg::lab {
namespace {

namespace pb = ::realitygrad::v1;

double Now() { return RealClock().SteadySeconds(); }

std::string Text(const char* format, auto... values) {
  char text[512];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

pb::JobSpec ManyTasks(int count, const std::string& kind, const std::string& payload) {
  pb::JobSpec job;
  job.set_kind("bench");
  job.set_submitted_by("bench");
  for (int i = 0; i < count; ++i) {
    pb::TaskSpec* task = job.add_tasks();
    task->set_name("t" + std::to_string(i));
    task->set_kind(kind);
    task->set_payload(payload);
  }
  return job;
}

// Submits them as jobs of at most 10,000 tasks and waits for all; seconds from the first submit to the last
// result.
Result<double> RunTasks(ServiceRig& rig, int count, const std::string& kind, const std::string& payload) {
  constexpr int kTasksPerJob = 10'000;
  std::vector<pb::JobSpec> specs;
  for (int begin = 0; begin < count; begin += kTasksPerJob)
    specs.push_back(ManyTasks(std::min(kTasksPerJob, count - begin), kind, payload));
  std::vector<int64_t> jobs;
  const double begin = Now();
  for (const pb::JobSpec& spec : specs) {
    RG_ASSIGN_OR_RETURN(const int64_t job, rig.client().Submit(spec));
    jobs.push_back(job);
  }
  for (const int64_t job : jobs) {
    RG_ASSIGN_OR_RETURN(const auto end, rig.client().WaitForJob(job, 600.0));
    if (end.job().state() != pb::JOB_STATE_SUCCEEDED)
      return InternalError("a job of nothing did not succeed: " + end.job().reason());
    RG_RETURN_IF_ERROR(rig.Check());
  }
  return Now() - begin;
}

class ServiceBench {
 public:
  ServiceBench(const ServiceBenchOptions& options, const CancelToken* cancel)
      : options_(options), cancel_(cancel) {}

  // Measures the group of rows that belong together, once.
  Status Measure(const std::string& key) {
    if (measured_.count(key) > 0) return Status::Ok();
    if (key == "tasks_per_s" || key == "task_overhead_ms") return DurableTasks();
    if (key == "executor_tasks_per_s") return ThroughExecutors();
    if (key == "dispatch_p99_ms") return Dispatch();
    if (key == "restart_1m_s" || key == "restart_1m_mib") return Restart();
    if (key == "archived_bytes_per_task") return Archive();
    if (key == "workers") return ManyWorkers();
    return Artifact();
  }
  const Measurement& Get(const std::string& key) { return measured_[key]; }

 private:
  Result<std::unique_ptr<ServiceRig>> MakeRig() {
    RG_ASSIGN_OR_RETURN(auto rig, ServiceRig::Make(cancel_));
    RG_RETURN_IF_ERROR(rig->StartCoordinator().status());
    return rig;
  }
  void Note(const std::string& key, double value, int samples, std::string note) {
    Measurement& m = measured_[key];
    m.key = key;
    m.value = value;
    m.samples = samples;
    m.note = std::move(note);
  }

  Status DurableTasks();
  Status ThroughExecutors();
  Status Dispatch();
  Status Restart();
  Status Archive();
  Status ManyWorkers();
  Status Artifact();

  const ServiceBenchOptions& options_;
  const CancelToken* cancel_;
  std::map<std::string, Measurement> measured_;
};

Status ServiceBench::DurableTasks() {
  const int count = options_.quick ? 10'000 : 60'000;
  constexpr const char* kResultBytes = "1024";
  RG_ASSIGN_OR_RETURN(auto rig, MakeRig());
  for (const char* name : {"a", "b"})
    RG_RETURN_IF_ERROR(rig->StartSimulatedWorkers(name, {"--slots", "256", "--summary-bytes", kResultBytes}));
  RG_RETURN_IF_ERROR(rig->AwaitWorkers(2));
  RG_RETURN_IF_ERROR(RunTasks(*rig, 1'000, kSimulatedKind, "warm").status());
  const double cpu = rig->CoordinatorCpuSeconds();
  RG_ASSIGN_OR_RETURN(const double seconds, RunTasks(*rig, count, kSimulatedKind, std::string(100, 'p')));
  const double cpu_us = 1e6 * (rig->CoordinatorCpuSeconds() - cpu) / count;
  rig->StopWorkers();
  for (const char* name : {"c", "d"})
    RG_RETURN_IF_ERROR(rig->StartSimulatedWorkers(name, {"--slots", "256", "--output-bytes", kResultBytes}));
  RG_RETURN_IF_ERROR(rig->AwaitWorkers(2));
  const int fewer = count / 4;
  RG_ASSIGN_OR_RETURN(const double with_output, RunTasks(*rig, fewer, kSimulatedKind, std::string(100, 'p')));
  const std::string note = Text(
      "%d tasks from the first submit to the last durable result of 1 KiB, two worker processes of 256 "
      "slots, CURVE, synchronous FULL; the coordinator took %.0f µs of CPU time a task; each result an "
      "artefact of 1 KiB instead: %.0f tasks/s",
      count, cpu_us, fewer / with_output);
  Note("tasks_per_s", count / seconds, count, note);
  Note("task_overhead_ms", 1e3 * seconds / count, count, note);
  return Status::Ok();
}

Status ServiceBench::ThroughExecutors() {
  const int count = options_.quick ? 1'000 : 12'000;
  RG_ASSIGN_OR_RETURN(auto rig, MakeRig());
  for (const char* name : {"a", "b"}) RG_RETURN_IF_ERROR(rig->StartWorker(name, 2));
  RG_RETURN_IF_ERROR(rig->AwaitWorkers(2));
  RG_RETURN_IF_ERROR(RunTasks(*rig, 100, jobs::kKindNothing, "").status());
  RG_ASSIGN_OR_RETURN(const double seconds, RunTasks(*rig, count, jobs::kKindNothing, ""));
  Note(
      "executor_tasks_per_s", count / seconds, count,
      Text("%d tasks of nothing in executor processes, two workers with two slots each, CURVE, synchronous "
             "FULL",
             count));
  return Status::Ok();
}

Status ServiceBench::Dispatch() {
  constexpr int kOffered = 1'000, kThreads = 4, kTasksPerJob = 10;
  const int seconds = options_.quick ? 2 : 10;
  RG_ASSIGN_OR_RETURN(auto rig, MakeRig());
  std::vector<std::string> files;
  for (const char* name : {"a", "b"}) {
    files.push_back(rig->folder() + "/delays-" + name);
    RG_RETURN_IF_ERROR(rig->StartSimulatedWorkers(name, {"--slots", "256", "--delays", files.back()}));
  }
  RG_RETURN_IF_ERROR(rig->AwaitWorkers(2));
  // Each thread submits at its own times, whatever the last submit took.
  constexpr double kInterval = 1.0 * kThreads * kTasksPerJob / kOffered;
  const double begin = Now() + 0.1;
  std::vector<std::thread> threads;
  std::atomic<int> failed{0}, late{0}, submitted{0};
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      auto client = rig->NewClient();
      if (!client.ok()) return ++failed, void();
      double due = begin + kInterval * t / kThreads;
      for (; due < begin + seconds; due += kInterval) {
        const double left = due - Now();
        if (left > 0) usleep(static_cast<useconds_t>(1e6 * left));
        late += Now() - due > 0.1;
        // From when it was due: a submit that had to wait for the one before counts its wait.
        const auto due_ns = static_cast<int64_t>(1e9 * due);
        const auto job = (*client)->Submit(ManyTasks(kTasksPerJob, kSimulatedKind, std::to_string(due_ns)));
        job.ok() ? ++submitted : ++failed;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  if (failed > 0) return InternalError("submits failed: " + std::to_string(failed));
  RG_RETURN_IF_ERROR(rig->client().WaitForJob(0, 60.0).status());
  usleep(500'000);
  rig->StopWorkers();
  std::vector<double> ms;
  for (const std::string& file : files) {
    std::ifstream in(file);
    for (double value; in >> value;) ms.push_back(value);
  }
  std::sort(ms.begin(), ms.end());
  if (ms.size() != static_cast<size_t>(submitted) * kTasksPerJob)
    return InternalError(std::to_string(ms.size()) + " assignments of " +
                         std::to_string(submitted * kTasksPerJob) + " tasks");
  Note(
      "dispatch_p99_ms", ms[ms.size() * 99 / 100], static_cast<int>(ms.size()),
      Text(
          "%d tasks/s offered for %d s in jobs of ten, from when the submit was due to the assignment in the "
          "worker's hands; median %.1f ms, worst %.1f ms; %d submits began more than 100 ms late",
          kOffered, seconds, ms[ms.size() / 2], ms.back(), late.load()));
  return Status::Ok();
}

Status ServiceBench::Restart() {
  const int64_t known = options_.quick ? 100'000 : 1'000'000, live = known / 100;
  RG_ASSIGN_OR_RETURN(auto rig, MakeRig());
  rig->StopCoordinator();
  RG_RETURN_IF_ERROR(FillServiceDatabase(rig->database(), known - live, live));
  RG_ASSIGN_OR_RETURN(const double seconds, rig->StartCoordinator());
  RG_ASSIGN_OR_RETURN(const auto status, rig->client().CoordinatorStatus());
  if (static_cast<int64_t>(status.tasks_ready()) != live)
    return InternalError("after the restart " + std::to_string(status.tasks_ready()) + " tasks are ready");
  const std::string note = Text(
      "%ld tasks, %ld of which ended (in 99 jobs, with an attempt and a result each) and %ld wait; from "
      "the program's start to its first answer; peak of resident memory",
      static_cast<long>(known), static_cast<long>(known - live), static_cast<long>(live));
  Note("restart_1m_s", seconds, 1, note);
  Note("restart_1m_mib", rig->CoordinatorMiB(true), 1, note);
  return Status::Ok();
}

Status ServiceBench::Archive() {
  const int64_t ended = options_.quick ? 9'900 : 99'000;
  RG_ASSIGN_OR_RETURN(auto rig, MakeRig());
  rig->StopCoordinator();
  RG_RETURN_IF_ERROR(FillServiceDatabase(rig->database(), ended, 1));
  const auto bytes = [&] {
    std::error_code error;
    return static_cast<double>(std::filesystem::file_size(rig->database(), error));
  };
  const double before = bytes();
  RG_RETURN_IF_ERROR(rig->StartCoordinator().status());
  const double begin = Now();
  RG_RETURN_IF_ERROR(rig->client().ArchiveJobs(0, false).status());
  const double seconds = Now() - begin;
  RG_ASSIGN_OR_RETURN(const auto jobs, rig->client().ListAllJobs());
  for (const auto& job : jobs) {
    if (job.finished_ns() != 0 && job.archived_ns() == 0)
      return InternalError("job " + std::to_string(job.id()) + " is not archived");
  }
  // What is free is given back in parts.
  constexpr double kStillS = 2.0, kPatienceS = 120.0;
  double after = before;
  for (double changed = Now(); Now() < changed + kStillS && Now() < begin + kPatienceS; usleep(50'000)) {
    RG_RETURN_IF_ERROR(rig->Check());
    if (const double size = bytes(); size < after) after = size, changed = Now();
  }
  const double count = static_cast<double>(ended);
  Note("archived_bytes_per_task", after / count, static_cast<int>(ended),
       Text("%ld ended tasks with an attempt and a result of 1 KiB each in 99 jobs; the file was %.0f MiB, "
              "%.0f B a "
              "task, and %.0f MiB after `jobs archive`, which took %.1f s",
              static_cast<long>(ended), before / (1 << 20), before / count, after / (1 << 20), seconds));
  return Status::Ok();
}

Status ServiceBench::ManyWorkers() {
  const int wanted = options_.workers;
  constexpr int kTasksEach = 20;
  RG_ASSIGN_OR_RETURN(auto rig, MakeRig());
  const int half = wanted / 2;
  for (const auto& [name, count] : {std::pair("a", half), std::pair("b", wanted - half)}) {
    RG_RETURN_IF_ERROR(rig->StartSimulatedWorkers(
        name, {"--count", std::to_string(count), "--slots", "1", "--seconds", "0.2"}));
  }
  RG_RETURN_IF_ERROR(rig->AwaitWorkers(static_cast<size_t>(wanted)));
  RG_ASSIGN_OR_RETURN(const double seconds, RunTasks(*rig, wanted * kTasksEach, kSimulatedKind, "p"));
  RG_ASSIGN_OR_RETURN(const auto workers, rig->client().Workers());
  RG_ASSIGN_OR_RETURN(const auto status, rig->client().CoordinatorStatus());
  int served = 0;
  for (const auto& worker : workers) served += worker.connected() && worker.tasks_done() > 0;
  const auto lost = status.counters().find("workers_lost_total");
  Note(
      "workers", served, 1,
      Text(
          "so many of %d simulated workers (two processes, a connection and one slot each) are connected and "
          "have done tasks; %d tasks of 0.2 s took %.1f s, %.1f s would be without any overhead; %.0f "
          "workers "
          "were lost",
          wanted, wanted * kTasksEach, seconds, 0.2 * kTasksEach,
          lost == status.counters().end() ? 0.0 : lost->second));
  return Status::Ok();
}

Status ServiceBench::Artifact() {
  const int64_t bytes = (options_.quick ? int64_t{64} : int64_t{1024}) << 20;
  RG_ASSIGN_OR_RETURN(auto rig, MakeRig());
  const std::string there = rig->folder() + "/there", back = rig->folder() + "/back";
  {
    Rng rng(1);
    std::ofstream out(there, std::ios::binary);
    std::vector<uint64_t> block(1 << 17);
    for (int64_t done = 0; done < bytes; done += static_cast<int64_t>(8 * block.size())) {
      for (uint64_t& word : block) word = rng.Next();
      out.write(reinterpret_cast<const char*>(block.data()), static_cast<std::streamsize>(8 * block.size()));
    }
    if (!out) return InternalError(there + ": cannot be written");
  }
  rusage before{}, after{};
  getrusage(RUSAGE_SELF, &before);
  pb::ArtifactInfo info;
  info.set_kind("bench");
  const double begin = Now();
  RG_ASSIGN_OR_RETURN(const std::string sha256, rig->client().PutArtifactFile(there, info));
  const double uploaded = Now();
  RG_RETURN_IF_ERROR(rig->client().GetArtifactFile(sha256, back).status());
  const double fetched = Now();
  getrusage(RUSAGE_SELF, &after);
  const double mb = 1e-6 * static_cast<double>(bytes);
  const double up = mb / (uploaded - begin), down = mb / (fetched - uploaded);
  Note("artifact_mb_per_s", std::min(up, down), 1,
       Text(
           "%ld MiB, the slower of up %.0f MB/s and down %.0f MB/s, hash checked on both ways, files synced; "
           "the client's memory grew by %ld MiB, the coordinator's peak is %.0f MiB",
           static_cast<long>(bytes >> 20), up, down, (after.ru_maxrss - before.ru_maxrss) / 1024,
           rig->CoordinatorMiB(true)));
  return Status::Ok();
}

}  // namespace

std::vector<Row> ServiceRows(bool quick) {
  return {
      {"tasks_per_s", "durable tasks, two worker processes", "1/s", 10'000, nullptr, true},
      {"task_overhead_ms", "  the same, per task", "ms", 0.1},
      {"executor_tasks_per_s", "through executors, 2×2 slots", "1/s", 3'000, nullptr, true},
      {"dispatch_p99_ms", "submit to worker at 1,000 tasks/s, p99", "ms", 50},
      {"restart_1m_s", quick ? "restart with 100,000 tasks known" : "restart with a million tasks known", "s", 2},
      {"restart_1m_mib", "  memory after it", "MiB", 512},
      {"archived_bytes_per_task", "file per ended task, archived", "B", 1'500},
      {"workers", "workers on one coordinator", "", 500, nullptr, true},
      {"artifact_mb_per_s", quick ? "an artefact of 64 MiB, up and down" : "an artefact of 1 GiB, up and down", "MB/s", 60, nullptr, true}};
}

Result<std::vector<Measurement>> RunServiceBench(const ServiceBenchOptions& options,
                                                 const ProgressFn& progress, const CancelToken* cancel) {
  ServiceBench service(options, cancel);
  const auto measure = [&](const std::string& key) {
    const Status measured = service.Measure(key);
    Measurement m = service.Get(key);
    if (!measured.ok()) m.value.reset(), m.note = measured.ToString();
    return m;
  };
  return MeasureRows(ServiceRows(), options.only, measure, progress, cancel);
}

}  // namespace rg::lab

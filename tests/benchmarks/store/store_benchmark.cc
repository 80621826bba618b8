// How many durable commits, rows and artefacts per second. Figures as JSON:
//   store_benchmark --benchmark_format=json
// RG_BENCHMARK_FOLDER chooses the disk (default: the system's folder for temporary files).
#include <benchmark/benchmark.h>

#include <cstdlib>
#include <filesystem>

#include "common/base/ids.h"
#include "common/base/rng.h"
#include "common/store/artifact_store.h"
#include "common/store/parameter_store.h"

namespace rg::store {
namespace {

class BenchmarkStore {
 public:
  explicit BenchmarkStore(bool durable = true) {
    const char* chosen = std::getenv("RG_BENCHMARK_FOLDER");
    folder_ = (chosen ? std::filesystem::path(chosen) : std::filesystem::temp_directory_path()) /
              ("rg_store_benchmark_" + RandomHex(6));
    std::vector<Module> modules{ArtifactStore::Schema(), ParameterStore::Schema()};
    modules.push_back(
        {"events", {{1, "CREATE TABLE event (id INTEGER PRIMARY KEY, task INTEGER, what TEXT);"}}});
    database = Database::Open({.path = (folder_ / "store.db").string(), .durable = durable}, modules).value();
    store = ArtifactStore::Open(database.get(), &RealClock()).value();
  }
  ~BenchmarkStore() {
    store.reset();
    database.reset();
    std::filesystem::remove_all(folder_);
  }
  std::unique_ptr<Database> database;
  std::unique_ptr<ArtifactStore> store;

 private:
  std::filesystem::path folder_;
};

std::string RandomBytes(Rng* rng, size_t size) {
  std::string bytes(size, '\0');
  for (char& c : bytes) c = static_cast<char>(rng->Next());
  return bytes;
}

// What a coordinator does per finished task: check the attempt, write its result and an event.
void BM_CommitOfRows(benchmark::State& state) {
  BenchmarkStore bench(state.range(1) != 0);
  int64_t task = 0;
  for (auto _ : state) {
    auto transaction = bench.database->Begin();
    for (int64_t i = 0; i < state.range(0); ++i) {
      auto insert = bench.database->Prepare("INSERT INTO event (task, what) VALUES (?, ?)");
      insert->Bind(1, ++task).Bind(2, "committed");
      RG_CHECK(insert->Run().ok());
    }
    RG_CHECK(transaction->Commit().ok());
  }
  state.counters["rows/s"] = benchmark::Counter(static_cast<double>(task), benchmark::Counter::kIsRate);
}
BENCHMARK(BM_CommitOfRows)
    ->ArgNames({"rows", "full"})
    ->Args({1, 1})
    ->Args({100, 1})
    ->Args({1000, 1})
    ->Args({100, 0})
    ->UseRealTime();

// Small artefacts, `group` to a commit.
void BM_PutGrouped(benchmark::State& state) {
  BenchmarkStore bench;
  Rng rng(1);
  int64_t puts = 0;
  for (auto _ : state) {
    auto transaction = bench.database->Begin();
    for (int64_t i = 0; i < state.range(0); ++i, ++puts)
      RG_CHECK(bench.store->Put(RandomBytes(&rng, state.range(1)), {.kind = "data", .job_id = "job"}).ok());
    RG_CHECK(transaction->Commit().ok());
  }
  state.counters["puts/s"] = benchmark::Counter(static_cast<double>(puts), benchmark::Counter::kIsRate);
}
BENCHMARK(BM_PutGrouped)
    ->ArgNames({"group", "bytes"})
    ->Args({1, 1024})
    ->Args({100, 1024})
    ->Args({100, 16384})
    ->UseRealTime();

void BM_PutLarge(benchmark::State& state) {
  BenchmarkStore bench;
  Rng rng(1);
  std::string bytes = RandomBytes(&rng, state.range(0));
  for (auto _ : state) {
    bytes[0] = static_cast<char>(rng.Next());
    bytes[1] = static_cast<char>(rng.Next());
    RG_CHECK(bench.store->Put(bytes, {.kind = "data"}).ok());
  }
  state.SetBytesProcessed(state.iterations() * state.range(0));
}
BENCHMARK(BM_PutLarge)->Arg(1 << 20)->Arg(16 << 20)->UseRealTime();

void BM_Get(benchmark::State& state) {
  BenchmarkStore bench;
  Rng rng(1);
  const std::string sha = bench.store->Put(RandomBytes(&rng, state.range(0)), {.kind = "data"})->sha256;
  for (auto _ : state) benchmark::DoNotOptimize(bench.store->Get(sha).value());
  state.SetBytesProcessed(state.iterations() * state.range(0));
}
BENCHMARK(BM_Get)->Arg(1024)->Arg(16 << 20)->UseRealTime();

}  // namespace
}  // namespace rg::store

BENCHMARK_MAIN();

// Power cuts at every kind of moment, with lost and torn writes, simulated below SQLite.
#include <gmock/gmock.h>

#include <set>

#include "common/base/rng.h"
#include "tests/support/fault_vfs/fault_vfs.h"
#include "tests/unit/store/store_fixture.h"

namespace rg::store {
namespace {

using testing_support::FaultVfs;

struct Outcome {
  int cuts = 0;
  int64_t acknowledged = 0;
  int64_t lost = 0;  // acknowledged, but gone after the cut
};

// Works until the power goes; returns what was acknowledged.
std::set<std::string> WorkUntilDark(Database* database, ArtifactStore* store, ParameterStore* parameters,
                                    const FaultVfs& vfs, Rng* rng) {
  std::set<std::string> acknowledged;
  while (!vfs.power_is_off()) {
    std::set<std::string> group;
    const Status committed = database->InTransaction([&]() -> Status {
      for (int k = 0; k < 3; ++k) {
        RG_ASSIGN_OR_RETURN(const PutResult put,
                            store->Put(SomeBytes(rng->Index(9000), rng->Next()), {.kind = "data"}));
        group.insert(put.sha256);
      }
      return parameters->Add({.robot = "r", .values = {{"a", rng->Uniform(), {}}}}, *group.begin()).status();
    });
    if (committed.ok()) acknowledged.merge(group);
    if (rng->Uniform() < 0.05) (void)database->Checkpoint();
  }
  return acknowledged;
}

Outcome CutRepeatedly(bool durable, int cuts, uint64_t seed) {
  Outcome outcome;
  FakeClock clock;
  for (int cut = 0; cut < cuts; ++cut) {
    TempFolder folder;
    const std::string path = folder / "store.db";
    Rng rng = Rng(seed).Split(cut);
    FaultVfs vfs;
    std::set<std::string> acknowledged;
    {
      auto database = Database::Open({.path = path, .durable = durable, .vfs = vfs.name()}, AllModules());
      EXPECT_TRUE(database.ok()) << database.status().ToString();
      auto store = ArtifactStore::Open(database->get(), &clock, {.chunk_bytes = 2000});
      ParameterStore parameters(database->get(), &clock);
      vfs.CutPowerAt(1 + static_cast<int64_t>(rng.Index(400)));
      acknowledged = WorkUntilDark(database->get(), store->get(), &parameters, vfs, &rng);
    }
    vfs.LeaveWhatTheDiskHolds(&rng);
    std::filesystem::remove(path + "-shm");

    FaultVfs well;  // as quick as the other, and never fails
    auto database = Database::Open({.path = path, .vfs = well.name()}, AllModules());
    EXPECT_TRUE(database.ok()) << "cut " << cut << ": " << database.status().ToString();
    if (!database.ok()) return outcome;
    auto store = ArtifactStore::Open(database->get(), &clock, {});
    EXPECT_TRUE((*database)->CheckIntegrity().ok()) << "cut " << cut;
    EXPECT_THAT((*store)->Verify()->damaged, testing::IsEmpty()) << "cut " << cut;
    ParameterStore parameters(database->get(), &clock);
    const auto history = parameters.History("r");
    for (size_t i = 0; i < history->size(); ++i)
      EXPECT_EQ((*history)[i].version, static_cast<int>(history->size() - i)) << "versions without gaps";
    for (const std::string& sha : acknowledged) outcome.lost += !(*store)->Contains(sha);
    EXPECT_TRUE((*store)->Put("life goes on", {.kind = "data"}).ok());
    outcome.acknowledged += static_cast<int64_t>(acknowledged.size());
    ++outcome.cuts;
  }
  return outcome;
}

TEST(StorePowerCut, LosesNothingThatWasAcknowledged) {
  const Outcome outcome = CutRepeatedly(/*durable=*/true, 60, 11);
  EXPECT_EQ(outcome.cuts, 60);
  EXPECT_EQ(outcome.lost, 0);
  EXPECT_GT(outcome.acknowledged, 500);
}

TEST(StorePowerCut, WouldShowALossIfThereWereOne) {
  // Not durable by choice: the simulation must be able to lose commits, but never to damage the file.
  const Outcome outcome = CutRepeatedly(/*durable=*/false, 20, 12);
  EXPECT_EQ(outcome.cuts, 20);
  EXPECT_GT(outcome.lost, 0);
}

}  // namespace
}  // namespace rg::store

#include "common/store/artifact_store.h"

#include <gmock/gmock.h>

#include "tests/unit/store/store_fixture.h"

namespace rg::store {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

class ArtifactStoreTest : public StoreTest {};

TEST_F(ArtifactStoreTest, BytesComeBackAsTheyWentInAfterReopening) {
  for (const size_t size : {size_t{0}, size_t{1}, size_t{999}, size_t{1000}, size_t{1001}, size_t{123456}}) {
    const std::string bytes = SomeBytes(size, size + 1);
    const std::string sha = PutOk(bytes, {.kind = "data"});
    EXPECT_EQ(sha, Sha256Hex(bytes));
    Reopen();
    auto got = store_->Get(sha);
    ASSERT_TRUE(got.ok()) << got.status().ToString();
    EXPECT_EQ(*got, bytes);
    EXPECT_EQ(Sha256Hex(*got), sha);
  }
  EXPECT_EQ(store_->CountAll()->artifacts, 6);
}

TEST_F(ArtifactStoreTest, StreamedPutEqualsPutAtOnce) {
  const std::string bytes = SomeBytes(54321);
  auto writer = store_->BeginPut();
  ASSERT_TRUE(writer.ok());
  for (size_t at = 0; at < bytes.size(); at += 777)
    ASSERT_TRUE(writer->Append(std::string_view(bytes).substr(at, 777)).ok());
  EXPECT_FALSE(store_->Contains(Sha256Hex(bytes))) << "visible before it is committed";
  auto put = writer->Commit({.kind = "data"}, Sha256Hex(bytes));
  ASSERT_TRUE(put.ok()) << put.status().ToString();
  EXPECT_FALSE(put->existed);
  EXPECT_EQ(*store_->Get(put->sha256), bytes);
  EXPECT_TRUE(store_->Put(bytes, {.kind = "data"})->existed);
  EXPECT_EQ(Count("artifact_upload"), 0);
}

TEST_F(ArtifactStoreTest, RepeatedPutIsHarmlessAndAddsLinks) {
  const std::string model = PutOk("model", {.kind = "model"});
  const std::string first = PutOk("shard", {.kind = "data", .job_id = "job1", .task_id = "t1"});
  const std::string again = PutOk(
      "shard", {.kind = "data", .metadata_json = R"({"late":1})", .parents = {model}, .job_id = "job2"});
  EXPECT_EQ(first, again);
  const auto info = store_->Info(first);
  EXPECT_EQ(info->job_id, "job1") << "the first production stays";
  EXPECT_EQ(info->metadata_json, "{}");
  EXPECT_THAT(info->parents, ElementsAre(model));
  EXPECT_EQ(store_->List({.job_id = "job1"})->size(), 1u);
  EXPECT_EQ(store_->List({.job_id = "job2"})->size(), 1u);
  EXPECT_EQ(store_->CountAll()->artifacts, 2);
}

TEST_F(ArtifactStoreTest, SameBytesAsAnotherKindAreRefusedByName) {
  PutOk("{}", {.kind = "report"});
  const auto put = store_->Put("{}", {.kind = "model"});
  EXPECT_EQ(put.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(put.status().message(), HasSubstr("report"));
}

TEST_F(ArtifactStoreTest, WrongHashKeepsNothing) {
  auto writer = store_->BeginPut();
  ASSERT_TRUE(writer->Append(SomeBytes(5000)).ok());
  const auto put = writer->Commit({.kind = "data"}, Sha256Hex("other"));
  EXPECT_EQ(put.status().code(), StatusCode::kDataLoss);
  EXPECT_EQ(Count("artifact_chunk"), 0);
  EXPECT_EQ(Count("artifact_upload"), 0);
  EXPECT_EQ(writer->Append("x").code(), StatusCode::kAborted);
}

TEST_F(ArtifactStoreTest, AbandonedUploadLeavesNothing) {
  { ASSERT_TRUE(store_->BeginPut()->Append(SomeBytes(5000)).ok()); }
  EXPECT_EQ(Count("artifact_chunk"), 0);
  EXPECT_EQ(Count("artifact_upload"), 0);
}

TEST_F(ArtifactStoreTest, UploadWhosePiecesWereRolledBackCannotBecomeAnArtifact) {
  auto writer = store_->BeginPut();
  ASSERT_TRUE(writer->Append(SomeBytes(2000)).ok());
  {
    auto transaction = database_->Begin();
    ASSERT_TRUE(writer->Append(SomeBytes(3000, 2)).ok());
    transaction->Rollback();
  }
  EXPECT_EQ(writer->Commit({.kind = "data"}).status().code(), StatusCode::kAborted);
  EXPECT_EQ(store_->CountAll()->artifacts, 0);
}

TEST_F(ArtifactStoreTest, UploadThatLostItsIdToARollbackTouchesNobodyElse) {
  auto transaction = database_->Begin();
  auto writer = store_->BeginPut();
  ASSERT_TRUE(writer->Append(SomeBytes(3000)).ok());
  transaction->Rollback();
  const std::string bytes = SomeBytes(4000, 9);
  const std::string sha = PutOk(bytes, {.kind = "data"});  // gets the same row id
  EXPECT_EQ(writer->Append(SomeBytes(3000)).code(), StatusCode::kAborted);
  EXPECT_EQ(*store_->Get(sha), bytes);
}

TEST_F(ArtifactStoreTest, ManyPutsInOneTransactionAreOneCommit) {
  {
    auto transaction = database_->Begin();
    for (int i = 0; i < 20; ++i) PutOk(SomeBytes(100, i), {.kind = "data"});
    EXPECT_FALSE(store_->Put("x", {.kind = "BAD KIND"}).ok()) << "one failure undoes only itself";
    ASSERT_TRUE(transaction->Commit().ok());
  }
  EXPECT_EQ(store_->CountAll()->artifacts, 20);
  {
    auto transaction = database_->Begin();
    PutOk("gone", {.kind = "data"});
  }
  EXPECT_EQ(store_->CountAll()->artifacts, 20);
}

TEST_F(ArtifactStoreTest, BadSpecificationsNameTheField) {
  EXPECT_THAT(store_->Put("x", {.kind = "Bad"}).status().message(), HasSubstr("kind \"Bad\""));
  EXPECT_THAT(store_->Put("x", {.kind = "a", .version = 0}).status().message(), HasSubstr("version 0"));
  EXPECT_THAT(store_->Put("x", {.kind = "a", .metadata_json = "[1]"}).status().message(),
              HasSubstr("metadata"));
  EXPECT_THAT(store_->Put("x", {.kind = "a", .parents = {"12"}}).status().message(), HasSubstr("parent"));
  const std::string absent = Sha256Hex("absent");
  const auto put = store_->Put("x", {.kind = "a", .parents = {absent}});
  EXPECT_EQ(put.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(put.status().message(), HasSubstr(absent));
  EXPECT_FALSE(store_->Contains(Sha256Hex("x"))) << "a refused put leaves nothing";
  EXPECT_EQ(store_->Put(SomeBytes((1 << 20) + 1), {.kind = "a"}).status().code(),
            StatusCode::kResourceExhausted);
}

TEST_F(ArtifactStoreTest, RangesAgreeWithTheWholeWhateverTheChunks) {
  const std::string bytes = SomeBytes(5432);
  const std::string sha = PutOk(bytes, {.kind = "data"});
  Reopen(/*chunk_bytes=*/333);  // another size now: the stored one counts
  for (const int64_t offset : {0, 1, 999, 1000, 1001, 5431, 5432})
    for (const int64_t limit : {0, 1, 1000, 2500, 100000})
      EXPECT_EQ(*store_->GetRange(sha, offset, limit), bytes.substr(offset, limit)) << offset << "+" << limit;
  EXPECT_EQ(store_->GetRange(sha, 5433, 1).status().code(), StatusCode::kInvalid);
  EXPECT_EQ(store_->GetRange(sha, -1, 1).status().code(), StatusCode::kInvalid);
}

TEST_F(ArtifactStoreTest, ABeginningOfAHashResolvesWhenItIsUnique) {
  const std::string sha = PutOk("x", {.kind = "data"});
  EXPECT_EQ(*store_->Resolve(sha.substr(0, 8)), sha);
  EXPECT_EQ(*store_->Resolve(sha), sha);
  EXPECT_EQ(store_->Resolve("ffffffffff").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(store_->Resolve(sha.substr(0, 5)).status().code(), StatusCode::kInvalid);
  EXPECT_EQ(store_->Resolve("abcdef%").status().code(), StatusCode::kInvalid);
}

TEST_F(ArtifactStoreTest, ListFiltersByKindAndJobNewestFirst) {
  PutOk("1", {.kind = "model", .job_id = "a"});
  PutOk("2", {.kind = "data", .job_id = "a"});
  PutOk("3", {.kind = "data", .job_id = "b"});
  PutOk("4", {.kind = "data", .job_id = "b"});
  EXPECT_EQ(store_->List()->size(), 4u);
  EXPECT_EQ(store_->List({.kind = "data"})->size(), 3u);
  EXPECT_EQ(store_->List({.kind = "data", .job_id = "b"})->size(), 2u);
  const auto newest = store_->List({.limit = 1});
  ASSERT_EQ(newest->size(), 1u);
  EXPECT_EQ(newest->front().sha256, Sha256Hex("4"));
}

TEST_F(ArtifactStoreTest, LineageCrossesKindsBothWays) {
  const std::string model = PutOk("model", {.kind = "model"});
  const std::string shard1 = PutOk("shard1", {.kind = "trajectories", .parents = {model}});
  const std::string shard2 = PutOk("shard2", {.kind = "trajectories", .parents = {model}});
  const std::string policy = PutOk("policy", {.kind = "policy", .parents = {shard1, shard2}});
  const std::string recording = PutOk("recording", {.kind = "recording", .parents = {policy}});
  const std::string params = PutOk("params", {.kind = "parameters", .parents = {recording, model}});
  const std::string other = PutOk("other", {.kind = "model"});

  const auto hashes = [](const Lineage& lineage) {
    std::vector<std::string> all;
    for (const auto& node : lineage.nodes) all.push_back(node.sha256);
    return all;
  };
  const auto up = store_->TraceLineage(policy, {.descendants = false});
  EXPECT_THAT(hashes(*up), UnorderedElementsAre(model, shard1, shard2, policy));
  const auto down = store_->TraceLineage(policy, {.ancestors = false});
  EXPECT_THAT(hashes(*down), UnorderedElementsAre(policy, recording, params));
  const auto near = store_->TraceLineage(policy, {.max_depth = 1});
  EXPECT_THAT(hashes(*near), UnorderedElementsAre(shard1, shard2, policy, recording));
  const auto all = store_->TraceLineage(params, {});
  EXPECT_EQ(all->nodes.size(), 6u);
  EXPECT_THAT(all->edges, testing::Contains(Lineage::Edge{recording, params}));
  EXPECT_EQ(all->edges.size(), 7u);
  EXPECT_EQ(store_->TraceLineage(other, {})->nodes.size(), 1u);
}

TEST_F(ArtifactStoreTest, LineageWithACycleEnds) {
  const std::string a = PutOk("a", {.kind = "data"});
  const std::string b = PutOk("b", {.kind = "data", .parents = {a}});
  PutOk("a", {.kind = "data", .parents = {b, a}});  // a deterministic task gave back an old artefact
  const auto lineage = store_->TraceLineage(a, {});
  EXPECT_EQ(lineage->nodes.size(), 2u);
  EXPECT_EQ(lineage->edges.size(), 2u);
  EXPECT_EQ(store_->Gc({})->removed.size(), 2u);
}

TEST_F(ArtifactStoreTest, VerifyNamesTheDamagedChunk) {
  const std::string good = PutOk(SomeBytes(2500, 1), {.kind = "data"});
  const std::string bad = PutOk(SomeBytes(4500, 2), {.kind = "policy"});
  EXPECT_THAT(store_->Verify()->damaged, IsEmpty());
  ASSERT_TRUE(database_
                  ->Execute("UPDATE artifact_chunk SET bytes = zeroblob(length(bytes)) WHERE id ="
                            " (SELECT id * 1048576 + 3 FROM artifact WHERE kind = 'policy')")
                  .ok());
  const auto report = store_->Verify();
  ASSERT_TRUE(report.ok());
  EXPECT_EQ(report->checked, 2);
  ASSERT_EQ(report->damaged.size(), 1u);
  EXPECT_EQ(report->damaged[0].sha256, bad);
  EXPECT_EQ(report->damaged[0].kind, "policy");
  EXPECT_THAT(report->damaged[0].what, HasSubstr("chunk 3 of 5 (from byte 3000)"));
  const auto got = store_->Get(bad);
  EXPECT_EQ(got.status().code(), StatusCode::kDataLoss);
  EXPECT_THAT(got.status().message(), HasSubstr("chunk 3"));
  EXPECT_TRUE(store_->Get(good).ok());
  EXPECT_TRUE(store_->GetRange(bad, 0, 3000).ok()) << "the undamaged beginning can still be read";
}

TEST_F(ArtifactStoreTest, VerifyFindsLostAndForgedBytes) {
  PutOk(SomeBytes(2500, 1), {.kind = "lost"});
  PutOk(SomeBytes(500, 2), {.kind = "forged"});
  ASSERT_TRUE(database_
                  ->Execute("DELETE FROM artifact_chunk WHERE id ="
                            " (SELECT id * 1048576 + 1 FROM artifact WHERE kind = 'lost')")
                  .ok());
  {
    // Bytes and checksum changed together: only the hash can tell.
    auto other = database_->Prepare(
        "UPDATE artifact_chunk SET bytes = (SELECT bytes FROM artifact_chunk WHERE id ="
        " (SELECT id * 1048576 FROM artifact WHERE kind = 'lost')), checksum ="
        " (SELECT checksum FROM artifact_chunk WHERE id ="
        " (SELECT id * 1048576 FROM artifact WHERE kind = 'lost')) WHERE id ="
        " (SELECT id * 1048576 FROM artifact WHERE kind = 'forged')");
    ASSERT_TRUE(other->Run().ok());
    ASSERT_TRUE(database_->Execute("UPDATE artifact SET size_bytes = 1000 WHERE kind = 'forged'").ok());
  }
  const auto report = store_->Verify();
  ASSERT_EQ(report->damaged.size(), 2u);
  EXPECT_THAT(report->damaged[0].what, HasSubstr("chunk 1 of 3 (from byte 1000): is missing"));
  EXPECT_THAT(report->damaged[1].what, HasSubstr("do not match its hash"));
}

TEST_F(ArtifactStoreTest, GcKeepsPinnedYoungAndAllTheirAncestors) {
  const std::string model = PutOk("model", {.kind = "model"});
  const std::string shard = PutOk("shard", {.kind = "data", .parents = {model}});
  const std::string policy = PutOk("policy", {.kind = "policy", .parents = {shard}});
  const std::string loose = PutOk(SomeBytes(5000), {.kind = "data", .parents = {model}, .job_id = "j"});
  ASSERT_TRUE(store_->Pin(policy, "user").ok());
  clock_.Advance(3600'000'000'000);
  const std::string young = PutOk("young", {.kind = "data"});
  const GcOptions hour{.older_than_ns = 1800'000'000'000, .dry_run = true};

  const auto plan = store_->Gc(hour);
  ASSERT_EQ(plan->removed.size(), 1u);
  EXPECT_EQ(plan->removed[0].sha256, loose);
  EXPECT_EQ(plan->bytes, 5000);
  EXPECT_TRUE(store_->Contains(loose)) << "a dry run removes nothing";

  ASSERT_TRUE(store_->Gc({.older_than_ns = hour.older_than_ns}).ok());
  EXPECT_FALSE(store_->Contains(loose));
  for (const auto& kept : {model, shard, policy, young}) EXPECT_TRUE(store_->Get(kept).ok());

  ASSERT_TRUE(store_->Unpin(policy, "user").ok());
  EXPECT_EQ(store_->Gc({.older_than_ns = hour.older_than_ns})->removed.size(), 3u);
  EXPECT_EQ(Count("artifact_chunk"), 1);
  EXPECT_TRUE(database_->CheckIntegrity().ok());
}

TEST_F(ArtifactStoreTest, GcKeepsWhatParametersAndOthersReferToAndItsAncestors) {
  const std::string urdf = PutOk("urdf", {.kind = "model"});
  const std::string recording = PutOk("recording", {.kind = "recording", .parents = {urdf}});
  const std::string model = PutOk("model", {.kind = "model", .parents = {recording}});
  const std::string input = PutOk("input", {.kind = "data"});
  const std::string loose = PutOk("loose", {.kind = "data"});
  ParameterStore parameters(database_.get(), &clock_);
  ASSERT_TRUE(parameters.Add({.robot = "arm", .model_sha256 = model, .values = {{"m", 1.0, {}}}}, "k").ok());
  clock_.Advance(1);
  const auto removed = store_->Gc({.references = {ParameterStore::kReferences, "SELECT '" + input + "'"}});
  ASSERT_TRUE(removed.ok()) << removed.status().ToString();
  ASSERT_EQ(removed->removed.size(), 1u);
  EXPECT_EQ(removed->removed[0].sha256, loose);
  for (const auto& kept : {urdf, recording, model, input}) EXPECT_TRUE(store_->Get(kept).ok());
}

TEST_F(ArtifactStoreTest, GcGoesInPartsAndTheFileShrinks) {
  constexpr size_t kBytes = 100'000;
  for (uint64_t i = 0; i < 20; ++i) PutOk(SomeBytes(kBytes, i), {.kind = "data"});
  const std::string kept = PutOk("kept", {.kind = "model"});
  ASSERT_TRUE(store_->Pin(kept, "user").ok());
  clock_.Advance(1);
  ASSERT_TRUE(database_->Checkpoint().ok());
  const auto before = std::filesystem::file_size(database_->path());
  EXPECT_GT(before, 20 * kBytes);
  int calls = 0;
  size_t removed = 0;
  for (bool more = true; more; ++calls) {
    const auto report = store_->Gc({.max_bytes = 5 * kBytes});
    ASSERT_TRUE(report.ok());
    removed += report->removed.size();
    more = report->more;
  }
  EXPECT_EQ(removed, 20u);
  EXPECT_EQ(calls, 4);
  EXPECT_EQ(*database_->FreePages(), 0);
  ASSERT_TRUE(database_->CheckpointPassively().ok());
  EXPECT_LT(std::filesystem::file_size(database_->path()), before / 5);
  EXPECT_TRUE(store_->Get(kept).ok());
  EXPECT_TRUE(database_->CheckIntegrity().ok());
}

TEST_F(ArtifactStoreTest, PuttingOldBytesAgainMakesThemYoung) {
  PutOk("old", {.kind = "data"});
  clock_.Advance(3600'000'000'000);
  PutOk("old", {.kind = "data"});
  EXPECT_THAT(store_->Gc({.older_than_ns = 1800'000'000'000})->removed, IsEmpty());
}

TEST_F(ArtifactStoreTest, PinsBelongToTheirOwners) {
  const std::string sha = PutOk("x", {.kind = "data"});
  ASSERT_TRUE(store_->Pin(sha, "job:1").ok());
  ASSERT_TRUE(store_->Pin(sha, "job:1").ok());
  ASSERT_TRUE(store_->Pin(sha, "job:2").ok());
  EXPECT_THAT(store_->Info(sha)->pins, ElementsAre("job:1", "job:2"));
  ASSERT_TRUE(store_->UnpinAll("job:1").ok());
  EXPECT_THAT(store_->Gc({})->removed, IsEmpty());
  ASSERT_TRUE(store_->UnpinAll("job:2").ok());
  EXPECT_EQ(store_->Gc({})->removed.size(), 1u);
  EXPECT_EQ(store_->Pin(sha, "job:3").code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace rg::store

#include "common/store/parameter_store.h"

#include <gmock/gmock.h>

#include <cmath>
#include <limits>

#include "tests/unit/store/store_fixture.h"

namespace rg::store {
namespace {

using testing::HasSubstr;

class ParameterStoreTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    parameters_ = std::make_unique<ParameterStore>(database_.get(), &clock_);
  }
  ParameterVersion AddOk(const ParameterVersion& version, const std::string& key = "") {
    auto added = parameters_->Add(version, key);
    EXPECT_TRUE(added.ok()) << added.status().ToString();
    return added.ok() ? *added : ParameterVersion();
  }
  static ParameterVersion Nominal() {
    return {.robot = "mico2",
            .values = {{"mass.a", 1.0, 0.1}, {"damping.j1", 0.3, {}}, {"gravity.z", -9.81, {}}}};
  }
  std::unique_ptr<ParameterStore> parameters_;
};

TEST_F(ParameterStoreTest, VersionsCountUpPerRobotAndComeBackExactly) {
  const std::string recording = PutOk("recording", {.kind = "recording"});
  const auto first = AddOk(Nominal());
  EXPECT_EQ(first.version, 1);
  ParameterVersion next = Nominal();
  next.parent_version = 1;
  next.source = ParameterSource::kIdentified;
  next.recording_sha256 = recording;
  next.residual_before = 129.8;
  next.residual_after = 47.8;
  next.job_id = "job-3";
  next.note = "0.2 s window";
  next.values[0].value = 1.0 / 3.0;
  next.values[1].value = 5e-324;
  clock_.Advance(5);
  EXPECT_EQ(AddOk(next).version, 2);
  EXPECT_EQ(AddOk({.robot = "ur10e", .values = {{"a", 1.0, {}}}}).version, 1);

  const auto shown = parameters_->Latest("mico2");
  ASSERT_TRUE(shown.ok());
  EXPECT_EQ(shown->version, 2);
  EXPECT_EQ(shown->parent_version, 1);
  EXPECT_EQ(shown->source, ParameterSource::kIdentified);
  EXPECT_EQ(shown->recording_sha256, recording);
  EXPECT_EQ(shown->residual_before, 129.8);
  EXPECT_EQ(shown->residual_after, 47.8);
  EXPECT_EQ(shown->job_id, "job-3");
  EXPECT_EQ(shown->note, "0.2 s window");
  EXPECT_EQ(shown->values, next.values) << "to the last bit";
  EXPECT_EQ(parameters_->Show("mico2", 1)->residual_before, std::nullopt);
  EXPECT_THAT(*parameters_->Robots(), testing::ElementsAre("mico2", "ur10e"));
}

TEST_F(ParameterStoreTest, HistoryIsNewestFirstAndLimited) {
  for (int i = 0; i < 5; ++i) AddOk(Nominal());
  const auto all = parameters_->History("mico2");
  ASSERT_EQ(all->size(), 5u);
  EXPECT_EQ(all->front().version, 5);
  EXPECT_EQ(all->back().version, 1);
  EXPECT_TRUE(all->front().values.empty());
  EXPECT_EQ(parameters_->History("mico2", 2)->size(), 2u);
  EXPECT_EQ(parameters_->History("nobody")->size(), 0u);
}

TEST_F(ParameterStoreTest, AVersionThatIsHeldBackIsCurrentOnlyWhereItIsPromoted) {
  EXPECT_EQ(*parameters_->Current("mico2"), 0);
  ParameterVersion early = Nominal();
  early.rollout = "stopped by velocity_limit after 1.44 of 6 s";
  early.held_back = true;
  AddOk(early);
  EXPECT_EQ(*parameters_->Current("mico2"), 0) << "there is no other";
  EXPECT_EQ(parameters_->Latest("mico2")->rollout, early.rollout);
  EXPECT_TRUE(parameters_->History("mico2")->front().held_back);
  AddOk(Nominal());
  AddOk(early);
  EXPECT_EQ(*parameters_->Current("mico2"), 2);
  ASSERT_TRUE(parameters_->Promote("mico2", 3).ok());
  EXPECT_EQ(*parameters_->Current("mico2"), 3) << "a person has looked";
  AddOk(Nominal());
  EXPECT_EQ(*parameters_->Current("mico2"), 3);
  ASSERT_TRUE(parameters_->Promote("mico2", 0).ok());
  EXPECT_EQ(*parameters_->Current("mico2"), 4);
}

TEST_F(ParameterStoreTest, DiffShowsChangedNewAndGoneWithSigmas) {
  AddOk(Nominal());
  AddOk({.robot = "mico2",
         .parent_version = 1,
         .source = ParameterSource::kIdentified,
         .values = {{"mass.a", 1.5, 0.1}, {"rotor.j1", 0.01, {}}, {"gravity.z", -9.81, {}}}});
  const auto diff = parameters_->Diff("mico2", 1, 2);
  ASSERT_TRUE(diff.ok());
  ASSERT_EQ(diff->rows.size(), 3u);
  EXPECT_EQ(diff->rows[0].name, "mass.a");
  EXPECT_EQ(diff->rows[0].from, 1.0);
  EXPECT_EQ(diff->rows[0].to, 1.5);
  EXPECT_NEAR(*diff->rows[0].sigmas, 0.5 / std::sqrt(0.02), 1e-12);
  EXPECT_EQ(diff->rows[1].name, "rotor.j1");
  EXPECT_EQ(diff->rows[1].from, std::nullopt);
  EXPECT_EQ(diff->rows[1].sigmas, std::nullopt);
  EXPECT_EQ(diff->rows[2].name, "damping.j1");
  EXPECT_EQ(diff->rows[2].to, std::nullopt);
  EXPECT_TRUE(parameters_->Diff("mico2", 2, 0)->rows.empty()) << "0 is the latest";
  EXPECT_EQ(parameters_->Diff("mico2", 1, 9).status().code(), StatusCode::kNotFound);
}

TEST_F(ParameterStoreTest, ARepeatWithTheSameKeyAddsNothing) {
  const auto first = AddOk(Nominal(), "task-7");
  ParameterVersion other = Nominal();
  other.values[0].value = 99;
  const auto again = AddOk(other, "task-7");
  EXPECT_EQ(again.id, first.id);
  EXPECT_EQ(again.values, first.values);
  EXPECT_EQ(parameters_->History("mico2")->size(), 1u);
  EXPECT_EQ(AddOk(Nominal(), "task-8").version, 2);
}

TEST_F(ParameterStoreTest, BadVersionsNameRobotAndParameter) {
  const auto message = [&](ParameterVersion version) {
    const auto added = parameters_->Add(version);
    EXPECT_FALSE(added.ok());
    return added.status().message();
  };
  EXPECT_THAT(message({.robot = "r"}), HasSubstr("no values"));
  EXPECT_THAT(message({.values = {{"a", 1, {}}}}), HasSubstr("robot's name"));
  EXPECT_THAT(message({.robot = "r", .values = {{"a", std::nan(""), {}}}}),
              HasSubstr("parameter a: not a finite"));
  EXPECT_THAT(message({.robot = "r", .values = {{"a", 1, -1.0}}}), HasSubstr("standard deviation"));
  EXPECT_THAT(message({.robot = "r", .values = {{"a", 1, {}}, {"a", 2, {}}}}), HasSubstr("a is there twice"));
  EXPECT_THAT(message({.robot = "r", .parent_version = 3, .values = {{"a", 1, {}}}}),
              HasSubstr("no version 3"));
  EXPECT_THAT(message({.robot = "r",
                       .residual_after = std::numeric_limits<double>::infinity(),
                       .values = {{"a", 1, {}}}}),
              HasSubstr("residual"));
  EXPECT_THAT(message({.robot = "r", .recording_sha256 = std::string(64, 'a'), .values = {{"a", 1, {}}}}),
              HasSubstr("not in the store"));
  EXPECT_EQ(parameters_->Robots()->size(), 0u);
}

TEST_F(ParameterStoreTest, TheRecordingOfAVersionIsNeverCollected) {
  const std::string recording = PutOk("recording", {.kind = "recording"});
  PutOk("other", {.kind = "recording"});
  ParameterVersion version = Nominal();
  version.recording_sha256 = recording;
  AddOk(version);
  EXPECT_EQ(store_->Gc({})->removed.size(), 1u);
  EXPECT_TRUE(store_->Get(recording).ok());
  EXPECT_THAT(store_->Info(recording)->pins, testing::ElementsAre("parameters:mico2/1"));
}

TEST_F(ParameterStoreTest, VersionAndArtifactsAreOneTransaction) {
  {
    auto transaction = database_->Begin();
    ParameterVersion version = Nominal();
    version.model_sha256 = PutOk("model", {.kind = "model"});
    AddOk(version);
  }
  EXPECT_EQ(parameters_->History("mico2")->size(), 0u);
  EXPECT_EQ(store_->CountAll()->artifacts, 0);
}

TEST(ParameterValues, BadJsonNamesTheEntry) {
  EXPECT_FALSE(ParseParameterValues("{").ok());
  EXPECT_THAT(ParseParameterValues(R"([{"name":"a","value":1},{"name":"b"}])").status().message(),
              HasSubstr("parameter value 1: no \"value\""));
  EXPECT_THAT(ParseParameterValues(R"([{"value":1}])").status().message(), HasSubstr("no \"name\""));
  EXPECT_THAT(ParseParameterValues(R"([{"name":"a","value":1,"stddev":"x"}])").status().message(),
              HasSubstr("stddev"));
}

TEST(ParameterValues, SourceNamesAreInverse) {
  for (const auto source :
       {ParameterSource::kNominal, ParameterSource::kIdentified, ParameterSource::kImported})
    EXPECT_EQ(*ParseParameterSource(ParameterSourceName(source)), source);
  EXPECT_FALSE(ParseParameterSource("guessed").ok());
}

}  // namespace
}  // namespace rg::store

#include "coordinator/server/read_desk.h"

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <filesystem>

#include "common/base/ids.h"
#include "common/store/artifact_store.h"
#include "common/store/database.h"
#include "common/store/parameter_store.h"
#include "coordinator/store/schema.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;

class ReadDeskTest : public ::testing::Test {
 protected:
  ReadDeskTest() : folder_("/tmp/rg-read-desk-" + RandomHex(6)), wake_fd_(eventfd(0, EFD_CLOEXEC)) {
    database_ = *store::Database::Open(
        {.path = folder_ + "/a.db"},
        {store::ArtifactStore::Schema(), store::ParameterStore::Schema(), CoordinatorSchema()});
    artifacts_ = *store::ArtifactStore::Open(database_.get(), &RealClock());
    desk_ = std::make_unique<ReadDesk>(folder_ + "/a.db", transport::Sender{"c", pb::ROLE_COORDINATOR},
                                       &RealClock(), [this] {
                                         const uint64_t one = 1;
                                         EXPECT_EQ(write(wake_fd_, &one, sizeof one), 8);
                                       });
  }
  ~ReadDeskTest() override {
    desk_.reset();
    close(wake_fd_);
    std::filesystem::remove_all(folder_);
  }
  template <class Body>
  Status Ask(const Body& body) {
    return desk_->Add(transport::MakeRequest(transport::Sender{"viewer", pb::ROLE_VIEWER}, body));
  }
  // Waits for it.
  template <class Reply>
  Result<Reply> Answer() {
    pollfd woken{wake_fd_, POLLIN, 0};
    EXPECT_EQ(poll(&woken, 1, 20'000), 1);
    uint64_t count = 0;
    EXPECT_EQ(read(wake_fd_, &count, sizeof count), 8);
    const auto answers = desk_->TakeAnswers();
    EXPECT_EQ(answers.size(), 1u);
    RG_RETURN_IF_ERROR(transport::ReplyStatus(answers.at(0)));
    return transport::Unpack<Reply>(answers.at(0));
  }

  const std::string folder_;
  const int wake_fd_;
  std::unique_ptr<store::Database> database_;
  std::unique_ptr<store::ArtifactStore> artifacts_;
  std::unique_ptr<ReadDesk> desk_;
};

TEST_F(ReadDeskTest, AnswersWhileTheSchedulerWritesAndShowsOnlyWhatIsCommitted) {
  ASSERT_TRUE(artifacts_->Put("committed", {.kind = "data"}).ok());
  auto transaction = *database_->Begin();
  const auto open = artifacts_->Put("open", {.kind = "data"});
  ASSERT_TRUE(Ask(pb::ListArtifactsRequest()).ok());
  EXPECT_EQ(Answer<pb::ListArtifactsReply>()->artifacts_size(), 1);
  ASSERT_TRUE(Ask(pb::VerifyArtifactsRequest()).ok());
  EXPECT_EQ(Answer<pb::VerifyArtifactsReply>()->checked(), 1u);
  pb::ShowArtifactRequest show;
  show.set_sha256(open->sha256);
  ASSERT_TRUE(Ask(show).ok());
  EXPECT_EQ(Answer<pb::ShowArtifactReply>().status().code(), StatusCode::kNotFound);
  ASSERT_TRUE(transaction.Commit().ok());
  ASSERT_TRUE(Ask(show).ok());
  EXPECT_EQ(Answer<pb::ShowArtifactReply>()->info().sha256(), open->sha256);
}

TEST_F(ReadDeskTest, NoDamageIsSeenInWhatIsCollectedMeanwhile) {
  for (int i = 0; i < 200; ++i) ASSERT_TRUE(artifacts_->Put(std::to_string(i), {.kind = "data"}).ok());
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(Ask(pb::VerifyArtifactsRequest()).ok());
    ASSERT_TRUE(artifacts_->Gc({.max_count = 40}).ok());
    const auto report = Answer<pb::VerifyArtifactsReply>();
    ASSERT_TRUE(report.ok()) << report.status().ToString();
    EXPECT_EQ(report->damaged_size(), 0);
  }
}

TEST_F(ReadDeskTest, ManyThatWaitAreRefusedAndTheEndBreaksOffWhatIsUnderWay) {
  ASSERT_TRUE(artifacts_->Put(std::string(8 << 20, 'x'), {.kind = "data"}).ok());
  Status last;
  for (int i = 0; i < 5'000 && last.ok(); ++i) last = Ask(pb::VerifyArtifactsRequest());
  EXPECT_EQ(last.code(), StatusCode::kResourceExhausted) << "the queue has an end";
  desk_.reset();  // with a thousand checks waiting
}

}  // namespace
}  // namespace rg::coordinator

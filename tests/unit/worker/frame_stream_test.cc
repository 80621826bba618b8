#include "worker/frame_stream.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <thread>

#include "realitygrad/v1/executor.pb.h"

namespace rg::worker {
namespace {

namespace pb = realitygrad::v1;

class FrameStream : public ::testing::Test {
 protected:
  void SetUp() override { ASSERT_EQ(socketpair(AF_UNIX, SOCK_STREAM, 0, ends_), 0); }
  void TearDown() override {
    for (const int end : ends_) close(end);
  }
  int ends_[2] = {-1, -1};
};

TEST_F(FrameStream, MessagesArriveWholeAndInOrderWhateverTheirSize) {
  const size_t sizes[] = {0, 1, 70'000, 3, 2'000'000, 5};
  std::thread writer([&] {
    for (const size_t size : sizes) {
      pb::FromExecutor message;
      message.mutable_checkpoint()->set_bytes(std::string(size, 'x'));
      ASSERT_TRUE(WriteFrame(ends_[0], message).ok());
    }
  });
  FrameReader reader;
  std::string frame;
  for (const size_t size : sizes) {
    while (!reader.Next(&frame)) ASSERT_EQ(reader.ReadSome(ends_[1]), FrameReader::State::kOpen);
    pb::FromExecutor message;
    ASSERT_TRUE(message.ParseFromString(frame));
    EXPECT_EQ(message.checkpoint().bytes().size(), size);
  }
  writer.join();
}

TEST_F(FrameStream, AClosedEndIsToldToBothSides) {
  close(ends_[0]);
  FrameReader reader;
  EXPECT_EQ(reader.ReadSome(ends_[1]), FrameReader::State::kClosed);
  EXPECT_EQ(WriteFrame(ends_[1], pb::FromExecutor()).code(), StatusCode::kUnavailable);
  ends_[0] = -1;
}

}  // namespace
}  // namespace rg::worker

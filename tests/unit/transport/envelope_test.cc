#include "common/transport/envelope.h"

#include <gmock/gmock.h>

#include "tests/unit/transport/messages.h"

namespace rg::transport {
namespace {

using testing::HasSubstr;

TEST(Envelope, PackAndUnpackAreInverse) {
  const Message request = Ask("abc");
  EXPECT_EQ(request.envelope.type(), "realitygrad.v1.ShowArtifactRequest");
  EXPECT_EQ(request.envelope.request_id().size(), 32u);
  EXPECT_NE(Ask("abc").envelope.request_id(), request.envelope.request_id());
  EXPECT_EQ(TextOf(request), "abc");
}

TEST(Envelope, UnpackingAnotherTypeNamesBoth) {
  const auto wrong = Unpack<TestReply>(Ask("abc"));
  EXPECT_EQ(wrong.status().code(), StatusCode::kInvalid);
  EXPECT_THAT(wrong.status().message(), HasSubstr("ShowArtifactRequest"));
  EXPECT_THAT(wrong.status().message(), HasSubstr("ShowArtifactReply"));
}

TEST(Envelope, BadPayloadIsInvalid) {
  Message message = Ask("abc");
  message.envelope.set_payload("\xff\xff\xff");
  EXPECT_EQ(Unpack<TestRequest>(message).status().code(), StatusCode::kInvalid);
}

TEST(Envelope, ErrorsKeepCodeAndLineAcrossTheWire) {
  const Message request = Ask("abc");
  for (int code = 1; code <= static_cast<int>(StatusCode::kInternal); ++code) {
    const Message reply = MakeErrorReply(kServer, request, Status(static_cast<StatusCode>(code), "why"));
    EXPECT_EQ(reply.envelope.request_id(), request.envelope.request_id());
    EXPECT_EQ(static_cast<int>(ReplyStatus(reply).code()), code);
    EXPECT_EQ(ReplyStatus(reply).message(), "why");
  }
  pb::ErrorDetail from_the_future;
  from_the_future.set_code(99);
  EXPECT_EQ(ToStatus(from_the_future).code(), StatusCode::kInternal);
}

TEST(Envelope, VersionsOutsideTheRangeAreRefusedWithTheSideToUpdate) {
  EXPECT_TRUE(CheckProtocolVersion(kProtocolVersion).ok());
  EXPECT_THAT(CheckProtocolVersion(kProtocolVersion + 1).message(), HasSubstr("receiving"));
  EXPECT_THAT(CheckProtocolVersion(0).message(), HasSubstr("sending"));
}

TEST(Envelope, RoleNamesAreInverse) {
  for (const auto role :
       {pb::ROLE_COORDINATOR, pb::ROLE_WORKER, pb::ROLE_AGENT, pb::ROLE_OPERATOR, pb::ROLE_VIEWER})
    EXPECT_EQ(*ParseRole(RoleName(role)), role);
  EXPECT_FALSE(ParseRole("root").ok());
}

}  // namespace
}  // namespace rg::transport

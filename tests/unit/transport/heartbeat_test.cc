#include "common/transport/heartbeat.h"

#include <gmock/gmock.h>

#include <limits>

namespace rg::transport {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

constexpr HeartbeatOptions kOptions{.interval_ns = 100, .missed_allowed = 2};

TEST(Heartbeat, SenderIsDueOncePerInterval) {
  HeartbeatSender sender(kOptions, 1000);
  EXPECT_TRUE(sender.Due(1000));
  sender.Sent(1000);
  EXPECT_FALSE(sender.Due(1099));
  EXPECT_TRUE(sender.Due(1100));
  EXPECT_EQ(sender.next(), 1100);
}

TEST(Heartbeat, SilentPeerExpiresOnceAfterTheTimeout) {
  HeartbeatMonitor monitor(kOptions);
  monitor.Seen("b", 0);
  monitor.Seen("a", 0);
  monitor.Seen("c", 150);
  EXPECT_THAT(monitor.TakeExpired(200), IsEmpty());
  EXPECT_EQ(monitor.NextDeadline(), 201);
  EXPECT_THAT(monitor.TakeExpired(201), ElementsAre("a", "b"));
  EXPECT_THAT(monitor.TakeExpired(201), IsEmpty());
  EXPECT_EQ(monitor.size(), 1u);
  monitor.Forget("c");
  EXPECT_EQ(monitor.NextDeadline(), std::numeric_limits<int64_t>::max());
}

TEST(Heartbeat, LateNewsDoNotTurnTheClockBack) {
  HeartbeatMonitor monitor(kOptions);
  monitor.Seen("a", 500);
  monitor.Seen("a", 400);
  EXPECT_EQ(monitor.last_seen("a"), 500);
  EXPECT_THAT(monitor.TakeExpired(700), IsEmpty());
  EXPECT_EQ(monitor.last_seen("x"), -1);
}

}  // namespace
}  // namespace rg::transport

#include "common/transport/endpoint.h"

#include <gtest/gtest.h>

#include "common/transport/zmq_socket.h"

namespace rg::transport {
namespace {

TEST(Endpoint, LoopbackIsAnAddressNotABeginning) {
  for (const char* here : {"tcp://127.0.0.1:1", "tcp://127.8.9.10:1", "tcp://localhost:1", "tcp://[::1]:1"})
    EXPECT_EQ(*ClassifyEndpoint(here), EndpointKind::kLoopback) << here;
  for (const char* away :
       {"tcp://127.evil.com:1", "tcp://127.0.0.1.evil.com:1", "tcp://127.:1", "tcp://127.1:1",
        "tcp://127.0.0.1;10.0.0.7:1", "tcp://localhost.evil.com:1", "tcp://[::2]:1", "tcp://*:1"})
    EXPECT_EQ(*ClassifyEndpoint(away), EndpointKind::kPublic) << away;
  Context context;
  EXPECT_FALSE(ConnectDealer(context, "tcp://127.evil.com:7341", {.allow_plain_loopback = true}).ok());
}

}  // namespace
}  // namespace rg::transport

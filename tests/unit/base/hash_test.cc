#include "common/base/hash.h"

#include <gtest/gtest.h>

#include <string>

#include "common/base/rng.h"

namespace rg {
namespace {

TEST(Sha256, MatchesTheStandardsExample) {
  EXPECT_EQ(Sha256Hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Sha256, MatchesTheStandardsMillionTimesA) {
  EXPECT_EQ(Sha256Hex(std::string(1'000'000, 'a')),
            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

// Short pieces go through libsodium, long ones through the processor's instructions where it has them.
TEST(Sha256, LongPiecesAgreeWithSingleBytesAtEveryAlignment) {
  Rng rng(1);
  for (int round = 0; round < 300; ++round) {
    std::string bytes(rng.Index(1500), '\0');
    for (char& c : bytes) c = static_cast<char>(rng.Next());
    Sha256 by_bytes, by_pieces;
    for (const char& c : bytes) by_bytes.Update(std::string_view(&c, 1));
    for (size_t at = 0; at < bytes.size();) {
      const size_t piece = rng.Index(400);
      by_pieces.Update(std::string_view(bytes).substr(at, piece));
      at += piece;
    }
    const std::string expected = by_bytes.FinishHex();
    EXPECT_EQ(by_pieces.FinishHex(), expected) << bytes.size();
    EXPECT_EQ(Sha256Hex(bytes), expected) << bytes.size();
  }
}

TEST(Sha256, PiecesGiveTheHashOfTheWhole) {
  Sha256 hash;
  hash.Update("a");
  hash.Update("bc");
  EXPECT_EQ(hash.FinishHex(), Sha256Hex("abc"));
}

}  // namespace
}  // namespace rg

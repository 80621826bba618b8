#include "services/rollouts/recording_bundle.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::rollouts {
namespace {

const Bundle kBundle{
    {"empty", ""}, {"rollout.json", "{}"}, {"exact", std::string(512, 'x')}, {"more", std::string(513, 'y')}};

TEST(RecordingBundle, PackedFilesComeBack) { EXPECT_EQ(UnpackBundle(PackBundle(kBundle)).value(), kBundle); }

TEST(RecordingBundle, AnyTarCanOpenIt) {
  const std::string folder = (std::filesystem::temp_directory_path() / ("rg-tar-" + RandomHex(6))).string();
  ASSERT_TRUE(WriteFileAtomically(folder + "/b.tar", PackBundle(kBundle)).ok());
  ASSERT_EQ(std::system(("tar -C " + folder + " -xf " + folder + "/b.tar").c_str()), 0);
  for (const auto& [name, content] : kBundle) EXPECT_EQ(ReadFile(folder + "/" + name).value(), content);
  std::filesystem::remove_all(folder);
}

TEST(RecordingBundle, ARolloutThatEndedTooEarlySaysHowInOneLine) {
  const auto of = [](const std::string& rollout) { return PackBundle({{"rollout.json", rollout}, {"manifest.json", "{}"}}); };
  const std::string early = of(R"({"rows": 0, "end_reason": "stale_state", "detail": "newest state is 0.774 s old",
                                   "ended_after_s": 0.04})");
  const Status refused = CheckRows(early, 2);
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_EQ(refused.message(),
            "the rollout was stopped by stale_state (newest state is 0.774 s old) after 0.04 s and left 0 rows, nothing "
            "can be identified from fewer than 2");
  EXPECT_EQ(LoadBundle(early).status().message(), refused.message());
  EXPECT_EQ(LoadBundleOfWholeTorques(early).status().message(), refused.message());
  EXPECT_TRUE(CheckRows(of(R"({"rows": 10, "end_reason": "completed"})"), kLeastRows).ok());
  EXPECT_EQ(CheckRows(of(R"({"rows": 9, "end_reason": "operator_stop"})"), kLeastRows).message(),
            "the rollout was stopped by operator_stop and left 9 rows, nothing can be identified from fewer than 10");
  EXPECT_TRUE(CheckRows(of("{}"), kLeastRows).ok()) << "no rollout";
  EXPECT_EQ(CheckRows("torn", 2).code(), StatusCode::kDataLoss);
}

TEST(RecordingBundle, EveryTruncationIsRefused) {
  const std::string bytes = PackBundle(kBundle);
  for (size_t cut = 0; cut + 1024 < bytes.size(); cut += 37)
    EXPECT_EQ(UnpackBundle(bytes.substr(0, cut)).status().code(), StatusCode::kDataLoss) << cut;
}

// Writes the checksum that the header's other bytes have.
void MendChecksum(std::string* bytes) {
  unsigned sum = 0;
  for (int i = 0; i < 512; ++i) sum += i >= 148 && i < 156 ? ' ' : static_cast<unsigned char>((*bytes)[i]);
  char text[8];
  std::snprintf(text, sizeof text, "%06o", sum);
  bytes->replace(148, 7, std::string(text, 7));
}

TEST(RecordingBundle, BrokenHeadersPathsAndLinksAreRefused) {
  const std::string good = PackBundle({{"aaaa", "1"}});
  std::string bytes = good;
  bytes[1] = 'b';
  EXPECT_EQ(UnpackBundle(bytes).status().code(), StatusCode::kDataLoss);
  MendChecksum(&bytes);
  EXPECT_TRUE(UnpackBundle(bytes).ok());
  bytes = good;
  bytes[1] = '/';
  MendChecksum(&bytes);
  EXPECT_EQ(UnpackBundle(bytes).status().code(), StatusCode::kDataLoss);
  bytes = good;
  bytes[156] = '2';  // a symbolic link
  MendChecksum(&bytes);
  EXPECT_EQ(UnpackBundle(bytes).status().code(), StatusCode::kDataLoss);
}

}  // namespace
}  // namespace rg::rollouts

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

#include "common/base/file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>

#include "common/base/ids.h"

namespace rg {
namespace {

std::string TempFolder() {
  const auto folder = std::filesystem::temp_directory_path() / ("rg_file_test_" + RandomHex(6));
  std::filesystem::create_directories(folder);
  return folder;
}

TEST(File, WritesMakeParentsAndReplaceWhole) {
  const std::string folder = TempFolder();
  const std::string path = folder + "/a/b.txt";
  ASSERT_TRUE(WriteFileAtomically(path, "one").ok());
  ASSERT_TRUE(WriteFileAtomically(path, std::string("two\0three", 9)).ok());
  EXPECT_EQ(*ReadFile(path), std::string("two\0three", 9));
  int entries = 0;
  for ([[maybe_unused]] const auto& e : std::filesystem::directory_iterator(folder + "/a")) ++entries;
  EXPECT_EQ(entries, 1) << "a temporary file was left behind";
  std::filesystem::remove_all(folder);
}

TEST(File, FailuresNameThePath) {
  EXPECT_EQ(ReadFile("/nowhere/x.csv").status().code(), StatusCode::kNotFound);
  EXPECT_NE(ReadFile("/nowhere/x.csv").status().message().find("/nowhere/x.csv"), std::string::npos);
  EXPECT_FALSE(WriteFileAtomically("/proc/rg/x", "y").ok());
  const std::string folder = TempFolder();
  std::filesystem::create_directories(folder + "/page.html");
  EXPECT_EQ(WriteFileAtomically(folder + "/page.html", "y").message(), folder + "/page.html: is a folder, not a file");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder), {}), 1) << "a temporary file was left behind";
  std::filesystem::remove_all(folder);
}

TEST(File, WhatNeverEndsOrIsNoFileIsRefused) {
  const std::string folder = TempFolder();
  ASSERT_EQ(::mkfifo((folder + "/pipe").c_str(), 0600), 0);
  std::filesystem::create_symlink("loop", folder + "/loop");
  for (const std::string& path : {folder + "/pipe", std::string("/dev/zero"), folder, folder + "/loop"}) {
    const Status status = ReadFile(path).status();
    EXPECT_FALSE(status.ok()) << path;
    EXPECT_NE(status.message().find(path), std::string::npos) << status.message();
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace rg

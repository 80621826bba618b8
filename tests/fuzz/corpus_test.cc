// What fuzzing found, and seeds, given to each reader again.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "common/base/file.h"
#include "tests/fuzz/readers.h"

namespace rg::fuzz {
namespace {

namespace fs = std::filesystem;

TEST(FuzzCorpus, EveryReaderSurvivesEveryInputKnown) {
  const char* source = std::getenv("RG_SOURCE_DIR");
  const fs::path corpus = fs::path(source ? source : ".") / "tests/fuzz/corpus";
  for (const Reader& reader : Readers()) {
    int inputs = 0;
    for (const auto& entry : fs::directory_iterator(corpus / reader.name)) {
      const auto bytes = ReadFile(entry.path().string());
      ASSERT_TRUE(bytes.ok()) << bytes.status().ToString();
      SCOPED_TRACE(entry.path().string());
      reader.read(*bytes);
      // Cut short anywhere, too: files end in the middle.
      for (size_t cut = 0; cut < bytes->size(); cut += 1 + bytes->size() / 50)
        reader.read(std::string_view(*bytes).substr(0, cut));
      ++inputs;
    }
    EXPECT_GT(inputs, 0) << reader.name;
  }
}

}  // namespace
}  // namespace rg::fuzz

#include "common/transport/keys.h"

#include <gmock/gmock.h>
#include <sys/stat.h>

#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::transport {
namespace {

using testing::HasSubstr;

class KeysTest : public testing::Test {
 protected:
  ~KeysTest() override { std::filesystem::remove_all(folder_); }
  std::string folder_ = (std::filesystem::temp_directory_path() / ("rg_keys_" + RandomHex(6))).string();
};

TEST_F(KeysTest, FilesComeBackAsTheyWereMadeAndSecretsArePrivate) {
  const auto made = GenerateKeyFiles(folder_, "host7", pb::ROLE_WORKER);
  ASSERT_TRUE(made.ok()) << made.status().ToString();
  const auto loaded = LoadKeyFile(folder_ + "/host7.key");
  ASSERT_TRUE(loaded.ok()) << loaded.status().ToString();
  EXPECT_EQ(loaded->name, "host7");
  EXPECT_EQ(loaded->role, pb::ROLE_WORKER);
  EXPECT_EQ(loaded->keys.public_key, made->keys.public_key);
  EXPECT_EQ(loaded->keys.secret_key, made->keys.secret_key);
  struct stat info {};
  ASSERT_EQ(::stat((folder_ + "/host7.key").c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600u);
  EXPECT_THAT(*ReadFile(folder_ + "/host7.pub"), testing::Not(HasSubstr(made->keys.secret_key)));
  EXPECT_EQ(LoadPublicKeyFile(folder_ + "/host7.pub")->keys.public_key, made->keys.public_key);
}

TEST_F(KeysTest, AnExistingKeyIsNotOverwrittenByAccident) {
  const auto first = GenerateKeyFiles(folder_, "a", pb::ROLE_WORKER);
  EXPECT_EQ(GenerateKeyFiles(folder_, "a", pb::ROLE_WORKER).status().code(), StatusCode::kAlreadyExists);
  const auto second = GenerateKeyFiles(folder_, "a", pb::ROLE_WORKER, /*overwrite=*/true);
  EXPECT_NE(first->keys.public_key, second->keys.public_key);
}

TEST_F(KeysTest, AReadableSecretIsRefused) {
  ASSERT_TRUE(GenerateKeyFiles(folder_, "a", pb::ROLE_WORKER).ok());
  ASSERT_EQ(::chmod((folder_ + "/a.key").c_str(), 0644), 0);
  const auto loaded = LoadKeyFile(folder_ + "/a.key");
  EXPECT_EQ(loaded.status().code(), StatusCode::kPermissionDenied);
  EXPECT_THAT(loaded.status().message(), HasSubstr("chmod 600"));
}

TEST_F(KeysTest, MixedUpHalvesAreNoticed) {
  ASSERT_TRUE(GenerateKeyFiles(folder_, "a", pb::ROLE_WORKER).ok());
  std::string text = *ReadFile(folder_ + "/a.key");
  const std::string own = LoadKeyFile(folder_ + "/a.key")->keys.public_key;
  text.replace(text.find(own), own.size(), GenerateKeyPair().public_key);
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/a.key", text).ok());
  ASSERT_EQ(::chmod((folder_ + "/a.key").c_str(), 0600), 0);
  EXPECT_THAT(LoadKeyFile(folder_ + "/a.key").status().message(), HasSubstr("does not belong"));
}

TEST_F(KeysTest, BadFilesNameTheField) {
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/x.pub", "name x\nrole king\npublic abc\n").ok());
  EXPECT_THAT(LoadPublicKeyFile(folder_ + "/x.pub").status().message(), HasSubstr("field role"));
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/x.pub", "name x\nrole worker\npublic abc\n").ok());
  EXPECT_THAT(LoadPublicKeyFile(folder_ + "/x.pub").status().message(), HasSubstr("field public"));
  EXPECT_EQ(LoadKeyFile(folder_ + "/none.key").status().code(), StatusCode::kNotFound);
  EXPECT_FALSE(GenerateKeyFiles(folder_, "../evil", pb::ROLE_WORKER).ok());
}

TEST_F(KeysTest, AllowListFileKeepsWhoIsAllowedAndForgetsWhoIsRevoked) {
  const std::string path = folder_ + "/allowed_keys";
  EXPECT_EQ(LoadAllowList(path)->size(), 0u) << "no file: nobody";
  const std::string a = GenerateKeyPair().public_key, b = GenerateKeyPair().public_key;
  ASSERT_TRUE(AllowKey(path, a, pb::ROLE_WORKER, "host7").ok());
  ASSERT_TRUE(AllowKey(path, b, pb::ROLE_OPERATOR, "anna").ok());
  EXPECT_EQ(AllowKey(path, GenerateKeyPair().public_key, pb::ROLE_WORKER, "anna").code(),
            StatusCode::kAlreadyExists);
  const auto list = LoadAllowList(path);
  ASSERT_EQ(list->Rows().size(), 2u);
  EXPECT_EQ(list->Rows()[0].entry.name, "host7");
  EXPECT_EQ(list->Find(b)->role, pb::ROLE_OPERATOR);
  ASSERT_TRUE(RevokeKey(path, "host7").ok());
  EXPECT_EQ(LoadAllowList(path)->Find(a), nullptr);
  EXPECT_EQ(RevokeKey(path, "host7").code(), StatusCode::kNotFound);
}

TEST_F(KeysTest, TheRightToRobotsIsGivenToOperatorsOneByOne) {
  const std::string path = folder_ + "/allowed_keys";
  const std::string anna = GenerateKeyPair().public_key, ben = GenerateKeyPair().public_key;
  ASSERT_TRUE(AllowKey(path, anna, pb::ROLE_OPERATOR, "anna").ok());
  ASSERT_TRUE(AllowKey(path, ben, pb::ROLE_OPERATOR, "ben", true).ok());
  EXPECT_FALSE(LoadAllowList(path)->Find(anna)->robots);
  EXPECT_TRUE(LoadAllowList(path)->Find(ben)->robots);
  ASSERT_TRUE(AllowKey(path, anna, pb::ROLE_OPERATOR, "anna", true).ok()) << "given later";
  ASSERT_TRUE(AllowKey(path, ben, pb::ROLE_OPERATOR, "ben").ok()) << "taken back";
  EXPECT_TRUE(LoadAllowList(path)->Find(anna)->robots);
  EXPECT_FALSE(LoadAllowList(path)->Find(ben)->robots);
  EXPECT_THAT(AllowKey(path, GenerateKeyPair().public_key, pb::ROLE_VIEWER, "v", true).message(),
              HasSubstr("an operator's, not a viewer's"));
  EXPECT_THAT(AllowList::Parse("operator " + anna + " anna everything\n", "f").status().message(),
              HasSubstr("[robots]"));
}

TEST_F(KeysTest, BadAllowListsNameTheLine) {
  const std::string key = GenerateKeyPair().public_key;
  EXPECT_THAT(AllowList::Parse("# c\nworker short a\n", "f").status().message(), HasSubstr("f: line 2"));
  EXPECT_THAT(AllowList::Parse("king " + key + " a\n", "f").status().message(), HasSubstr("role \"king\""));
  EXPECT_THAT(AllowList::Parse("worker " + key + "\n", "f").status().message(), HasSubstr("line 1"));
  EXPECT_THAT(AllowList::Parse("worker " + key + " a\nviewer " + key + " b\n", "f").status().message(),
              HasSubstr("already allowed"));
  EXPECT_TRUE(AllowList::Parse("", "f").ok());
}

TEST_F(KeysTest, AChangedAllowListIsSeenOnceAndABadOneChangesNothing) {
  const std::string path = folder_ + "/allowed_keys";
  AllowListFile file(path);
  EXPECT_EQ((*file.Changed())->size(), 0u) << "the first call always gives the list";
  EXPECT_FALSE(file.Changed()->has_value());
  ASSERT_TRUE(AllowKey(path, GenerateKeyPair().public_key, pb::ROLE_WORKER, "host7").ok());
  EXPECT_EQ((*file.Changed())->size(), 1u);
  EXPECT_FALSE(file.Changed()->has_value());
  ASSERT_TRUE(WriteFileAtomically(path, "nonsense\n").ok());
  EXPECT_THAT(file.Changed().status().message(), HasSubstr("line 1"));
  EXPECT_FALSE(file.Changed()->has_value()) << "told once";
}

TEST_F(KeysTest, ListShowsEachKeyOnceWithoutSecrets) {
  ASSERT_TRUE(GenerateKeyFiles(folder_, "b", pb::ROLE_WORKER).ok());
  ASSERT_TRUE(GenerateKeyFiles(folder_, "a", pb::ROLE_COORDINATOR).ok());
  const auto keys = ListKeys(folder_);
  ASSERT_TRUE(keys.ok()) << keys.status().ToString();
  ASSERT_EQ(keys->size(), 2u);
  EXPECT_EQ((*keys)[0].name, "a");
  EXPECT_EQ((*keys)[0].keys.secret_key, "");
  EXPECT_EQ(ListKeys(folder_ + "/none")->size(), 0u);
}

}  // namespace
}  // namespace rg::transport

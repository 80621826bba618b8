#include "common/model/urdf_xml.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace rg::model {
namespace {

struct Wrong {
  const char* name;
  const char* source;
  std::string text;
  std::string message;
};

class WrongFile : public testing::TestWithParam<Wrong> {};

TEST_P(WrongFile, IsToldAsWhatItIs) {
  TiXmlDocument document;
  const Status status = ParseUrdfXml(GetParam().text, GetParam().source, &document);
  EXPECT_EQ(status.code(), StatusCode::kInvalid);
  EXPECT_EQ(status.message(), GetParam().message);
}

std::string Nested(int depth) {
  std::string text = "<robot name='r'>";
  for (int i = 1; i < depth; ++i) text += "<a b='/>'>";
  for (int i = 1; i < depth; ++i) text += "</a>";
  return text + "</robot>";
}

INSTANTIATE_TEST_SUITE_P(
    Each, WrongFile,
    testing::ValuesIn(std::vector<Wrong>{
        {"Empty", "a.urdf", "", "a.urdf: the file is empty"},
        {"Blank", "a.urdf", "\xEF\xBB\xBF \r\n", "a.urdf: the file is empty"},
        {"GitLfs", "a.urdf", "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
         "a.urdf: is a git-lfs pointer, the file itself was not fetched: run git lfs pull"},
        {"Html", "a.urdf", "\n<!DOCTYPE html>\n<html><body><p>Not found</body></html>",
         "a.urdf: is an HTML page, not a URDF: download the raw file"},
        {"XHtml", "a.urdf", "<?xml version='1.0'?><html/>",
         "a.urdf: is an HTML page, not a URDF: download the raw file"},
        {"Binary", "a.urdf", std::string("PK\x03\x04\0\0", 6),
         "a.urdf: is a binary file, not a URDF (byte 5 is 0)"},
        {"TextBehindNul", "a.urdf", std::string("<robot name='r'/>\0<link/>", 25),
         "a.urdf: is a binary file, not a URDF (byte 18 is 0)"},
        {"Utf16", "a.urdf", std::string("\xFF\xFE<\0r\0", 6), "a.urdf: is UTF-16: save it as UTF-8"},
        {"Sdf", "a.sdf", "<?xml version='1.0'?><sdf version='1.6'><model name='m'/></sdf>",
         "a.sdf: the root element is <sdf>: this is an SDF file; the robot's URDF is needed"},
        {"Mjcf", "a.xml", "<mujoco model='m'><worldbody/></mujoco>",
         "a.xml: the root element is <mujoco>: this is an MJCF file; the robot's URDF is needed"},
        {"AnotherRoot", "a.urdf", "<robots name='r'/>", "a.urdf: the root element is 'robots', not <robot>"},
        {"TwoRoots", "a.urdf", "<robot name='r'/>\n<link name='a'/>",
         "a.urdf: row 2: a second root element, 'link'"},
        {"XacroElement", "arm.urdf.xacro", "<robot name='r'>\n <xacro:property name='m' value='2'/></robot>",
         "arm.urdf.xacro: row 2: <xacro:property>: this is a xacro file, not a URDF; expand it: "
         "xacro arm.urdf.xacro > arm.urdf"},
        {"XacroExpression", "robot/arm.urdf",
         "<robot name='r'><link name='a'><visual>\n<origin xyz='0 0 ${-l/2}'/></visual></link></robot>",
         "robot/arm.urdf: row 2: <origin xyz> is '0 0 ${-l/2}': this is a xacro file, not a URDF; expand it: "
         "xacro robot/arm.urdf > robot/arm_expanded.urdf"},
        {"XacroWithoutUrdf", "arm.xacro", "<robot name='${prefix}arm'/>",
         "arm.xacro: row 1: <robot name> is '${prefix}arm': this is a xacro file, not a URDF; expand it: "
         "xacro arm.xacro > arm.urdf"},
        {"TooDeep", "a.urdf", Nested(201), "a.urdf: more than 200 elements inside each other"},
        {"MuchTooDeep", "a.urdf", Nested(1000000), "a.urdf: more than 200 elements inside each other"},
        {"TooDeepAndOpen", "a.urdf", "<robot name='r'>" + std::string(300000, '<'),
         "a.urdf: more than 200 elements inside each other"},
        {"TooLarge", "a.urdf", std::string((33u << 20) + 1, ' '),
         "a.urdf: has 33 MB, more than 32: is it a URDF?"},
    }),
    [](const auto& info) { return std::string(info.param.name); });

TEST(UrdfXml, TakesWhatIsWellFormed) {
  const std::string texts[] = {
      "<robot name='r'/>",
      "\xEF\xBB\xBF<?xml version='1.0' encoding='UTF-8'?><robot name='r'/>",
      "<!-- ${not.an.attribute} <a><b> --><robot xmlns:xacro='http://ros.org/wiki/xacro' name='r'>$</robot>",
      Nested(200),
  };
  for (const std::string& text : texts) {
    TiXmlDocument document;
    const Status status = ParseUrdfXml(text, "a.urdf", &document);
    EXPECT_TRUE(status.ok()) << status.message();
  }
}

TEST(UrdfXml, NamesTheRowThatIsNotWellFormed) {
  TiXmlDocument document;
  EXPECT_EQ(ParseUrdfXml("<robot name='r'>\n<link name='a'>\n</robot>", "a.urdf", &document)
                .message()
                .find("a.urdf: row 3: not well-formed XML: "),
            0u);
}

TEST(UrdfXml, QuotesForOneLine) {
  EXPECT_EQ(Quoted("a\tb\nc"), "'a b c'");
  EXPECT_EQ(Quoted("gr\xC3\xBCn\xFF"), "'gr\xC3\xBCn?'");
  EXPECT_EQ(Quoted(std::string(80, 'x')), "'" + std::string(60, 'x') + "...'");
}

}  // namespace
}  // namespace rg::model

#include "common/model/urdf_xml.h"

#include <algorithm>
#include <cctype>

#include "common/base/utf8.h"

namespace rg::model {
namespace {

constexpr size_t kMaxBytes = 32u << 20;
constexpr int kMaxDepth = 200;  // TinyXML recurses
constexpr std::string_view kBlanks = " \t\r\n";

std::string_view Start(std::string_view text) {
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  text.remove_prefix(std::min(text.find_first_not_of(kBlanks), text.size()));
  return text;
}

bool StartsWithNoCase(std::string_view text, std::string_view lower) {
  return text.size() >= lower.size() &&
         std::equal(lower.begin(), lower.end(), text.begin(),
                    [](char a, char b) { return a == std::tolower(static_cast<unsigned char>(b)); });
}

// What the bytes are if they are no XML at all; empty: they may be.
std::string NotXml(std::string_view xml) {
  if (xml.size() > kMaxBytes) {
    return "has " + std::to_string(xml.size() >> 20) + " MB, more than " + std::to_string(kMaxBytes >> 20) +
           ": is it a URDF?";
  }
  if (xml.starts_with("\xFF\xFE") || xml.starts_with("\xFE\xFF")) {
    return "is UTF-16: save it as UTF-8";
  }
  const std::string_view start = Start(xml);
  if (start.empty()) return "the file is empty";
  if (start.starts_with("version https://git-lfs")) {
    return "is a git-lfs pointer, the file itself was not fetched: run git lfs pull";
  }
  if (StartsWithNoCase(start, "<!doctype html") || StartsWithNoCase(start, "<html")) {
    return "is an HTML page, not a URDF: download the raw file";
  }
  if (xml.starts_with("\x1F\x8B")) return "is compressed: gunzip it first";
  if (xml.find("<!ENTITY") != std::string_view::npos) {
    return "declares entities (<!ENTITY>), which are not expanded here; expand them: xmllint --noent FILE > "
           "NEW";
  }
  if (const size_t nul = xml.find('\0'); nul != std::string_view::npos) {
    return "is a binary file, not a URDF (byte " + std::to_string(nul + 1) + " is 0)";
  }
  return "";
}

// End of the tag that begins at `at`, behind its '>', which quotes may hide, or where another one begins.
size_t EndOfTag(std::string_view xml, size_t at) {
  char quote = 0;
  for (++at; at < xml.size(); ++at) {
    const char c = xml[at];
    if (quote != 0) {
      if (c == quote) quote = 0;
    } else if (c == '"' || c == '\'') {
      quote = c;
    } else if (c == '>') {
      return at + 1;
    } else if (c == '<') {
      return at;
    }
  }
  return xml.size();
}

size_t Behind(std::string_view xml, std::string_view what, size_t at) {
  const size_t found = xml.find(what, at);
  return found == std::string_view::npos ? xml.size() : found + what.size();
}

// The deepest nesting of elements, or a little more where the text is not well-formed.
int Depth(std::string_view xml) {
  int depth = 0, deepest = 0;
  for (size_t at = xml.find('<'); at < xml.size(); at = xml.find('<', at)) {
    const std::string_view rest = xml.substr(at);
    if (rest.starts_with("<!--")) {
      at = Behind(xml, "-->", at);
    } else if (rest.starts_with("<![CDATA[")) {
      at = Behind(xml, "]]>", at);
    } else if (rest.starts_with("<!") || rest.starts_with("<?")) {
      at = Behind(xml, ">", at);
    } else if (rest.starts_with("</")) {
      at = Behind(xml, ">", at);
      --depth;
    } else {
      at = EndOfTag(xml, at);
      deepest = std::max(deepest, ++depth);
      if (at >= 2 && xml[at - 2] == '/') --depth;
    }
  }
  return deepest;
}

// "xacro arm.xacro > arm.urdf", never a redirection of a file into itself.
std::string XacroCommand(const std::string& source) {
  constexpr std::string_view kSuffix = ".xacro";
  std::string plain = source;
  if (plain.ends_with(kSuffix)) plain.resize(plain.size() - kSuffix.size());
  const bool is_new = plain != source;
  if (plain.ends_with(".urdf")) plain.resize(plain.size() - 5);
  return "xacro " + source + " > " + plain + (is_new ? ".urdf" : "_expanded.urdf");
}

// Where "$(arg x)" is other programs' own.
bool IsOthers(const std::string& tag) {
  for (const char* name : {"visual", "collision", "gazebo", "transmission", "ros2_control", "sensor"}) {
    if (tag == name) return true;
  }
  return false;
}

// The first place that only xacro can read, "row 7: <xacro:macro>"; empty: there is none.
std::string XacroPlace(const TiXmlElement& element, bool others = false) {
  const std::string row = "row " + std::to_string(element.Row()) + ": ";
  if (element.ValueStr().starts_with("xacro:")) return row + "<" + element.ValueStr() + ">";
  others = others || IsOthers(element.ValueStr());
  for (const TiXmlAttribute* a = element.FirstAttribute(); a != nullptr; a = a->Next()) {
    const std::string& value = a->ValueStr();
    if (value.find("${") == std::string::npos && (others || value.find("$(") == std::string::npos)) continue;
    return row + "<" + element.ValueStr() + " " + a->NameTStr() + "> is " + Quoted(value);
  }
  for (const TiXmlElement* e = element.FirstChildElement(); e != nullptr; e = e->NextSiblingElement()) {
    if (std::string place = XacroPlace(*e, others); !place.empty()) return place;
  }
  return "";
}

Status CheckRoot(const TiXmlDocument& document, const std::string& source) {
  const TiXmlElement* root = document.RootElement();
  const std::string name = root == nullptr ? "" : root->ValueStr();
  const auto error = [&](const std::string& what) { return InvalidError(source + ": " + what); };
  if (name == "sdf" || name == "gazebo") {
    return error("the root element is <" + name + ">: this is an SDF file; the robot's URDF is needed");
  }
  if (name == "mujoco" || name == "mujocoinclude") {
    return error("the root element is <" + name + ">: this is an MJCF file; the robot's URDF is needed");
  }
  if (StartsWithNoCase(name, "html")) return error("is an HTML page, not a URDF: download the raw file");
  if (name != "robot") return error("the root element is " + Quoted(name) + ", not <robot>");
  if (const TiXmlElement* second = root->NextSiblingElement()) {
    return error("row " + std::to_string(second->Row()) + ": a second root element, " +
                 Quoted(second->ValueStr()));
  }
  return Status::Ok();
}

}  // namespace

std::string Quoted(std::string_view text) {
  constexpr size_t kLongest = 60;
  std::string shown = CleanUtf8(text, kLongest);
  if (shown.size() < text.size()) shown += "...";
  for (char& c : shown) {
    if (static_cast<unsigned char>(c) < ' ' || c == 0x7F) c = ' ';
  }
  return "'" + shown + "'";
}

Status ParseUrdfXml(const std::string& xml, const std::string& source_name, TiXmlDocument* document) {
  const std::string prefix = source_name + ": ";
  if (const std::string what = NotXml(xml); !what.empty()) return InvalidError(prefix + what);
  if (Depth(xml) > kMaxDepth) {
    return InvalidError(prefix + "more than " + std::to_string(kMaxDepth) + " elements inside each other");
  }
  // TinyXML steps over a broken UTF-8 letter by its announced length, past the end if it is the last one.
  const std::string padded = xml + std::string(8, '\0');
  document->Parse(padded.c_str());
  if (document->Error()) {
    return InvalidError(prefix + "row " + std::to_string(document->ErrorRow()) +
                        ": not well-formed XML: " + document->ErrorDesc());
  }
  RG_RETURN_IF_ERROR(CheckRoot(*document, source_name));
  const std::string place = XacroPlace(*document->RootElement());
  if (place.empty()) return Status::Ok();
  return InvalidError(prefix + place +
                      ": this is a xacro file, not a URDF; expand it: " + XacroCommand(source_name));
}

}  // namespace rg::model

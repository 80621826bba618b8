// Small URDF texts for tests, by hand and at random, with numbers in any spelling.
#pragma once

#include <string>
#include <vector>

#include "common/base/rng.h"

namespace rg::testing_support {

inline const char* const kUnitInertial =
    R"(<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>)";
inline const char* const kUnitLimit = R"(<limit lower="-1" upper="1" effort="1" velocity="1"/>)";

inline std::string RobotXml(const std::string& body) {
  return R"(<?xml version="1.0"?><robot name="r">)" + body + "</robot>";
}
inline std::string LinkXml(const std::string& name, const std::string& inside = kUnitInertial) {
  return "<link name=\"" + name + "\">" + inside + "</link>";
}
inline std::string JointXml(const std::string& name, const std::string& type, const std::string& parent,
                            const std::string& child, const std::string& inside = kUnitLimit) {
  return "<joint name=\"" + name + "\" type=\"" + type + "\"><parent link=\"" + parent +
         "\"/><child link=\"" + child + "\"/>" + inside + "</joint>";
}
inline std::string MimicXml(const std::string& driver, const std::string& more = "") {
  return "<mimic joint=\"" + driver + "\" " + more + "/>";
}

// A random robot in URDF: a tree of links with turned inertials, joints of all supported types, mimics.
// The same `rng` gives the same robot; `is_odd` spells its numbers as writers of XML do, else plainly.
class RandomUrdf {
 public:
  RandomUrdf(Rng rng, bool is_odd) : values_(rng), spelling_(rng.Split(1)), is_odd_(is_odd) {}

  std::string Text() {
    const int n = 2 + static_cast<int>(values_.Index(9));
    std::string body;
    for (int i = 0; i < n; ++i) body += Link(i);
    for (int i = 1; i < n; ++i) body += Joint(i);
    return RobotXml(body);
  }

 private:
  static std::string LinkName(int i) { return "l" + std::to_string(i); }
  static std::string JointName(int i) { return "j" + std::to_string(i); }

  // Thousandths between low and high, in text.
  std::string Number(int low, int high) {
    const int value = low + static_cast<int>(values_.Index(static_cast<uint64_t>(high - low + 1)));
    return is_odd_ ? Odd(value) : Plain(value);
  }
  std::string Numbers(int count, int low, int high) {
    std::string text;
    for (int i = 0; i < count; ++i) text += (i == 0 ? "" : Blank()) + Number(low, high);
    return text;
  }
  std::string Blank() {
    static const char* const kBlanks[] = {" ", "  ", "\t", "\n      ", " \r\n ", "\t \t"};
    return is_odd_ ? kBlanks[spelling_.Index(6)] : " ";
  }
  static std::string Digits(int value, size_t width) {
    std::string digits = std::to_string(value);
    return digits.size() < width ? std::string(width - digits.size(), '0') + digits : digits;
  }
  static std::string Plain(int value) {
    const int size = value < 0 ? -value : value;
    return (value < 0 ? "-" : "") + std::to_string(size / 1000) + "." + Digits(size % 1000, 3);
  }
  std::string Odd(int value) {
    const int size = value < 0 ? -value : value;
    const std::string whole = std::to_string(size / 1000), part = Digits(size % 1000, 3),
                      all = std::to_string(size);
    const std::string sign = value < 0 ? "-" : spelling_.Index(2) == 0 ? "+" : "";
    const std::string spelled[] = {
        whole + "." + part,
        (size < 1000 ? "" : whole) + "." + part,
        all + "e-3",
        all + ".E-03",
        "00" + whole + "." + part,
        whole + "." + part + "000000000000000000000000",
        "0.00" + all + "e+0",
        "." + Digits(size, 6) + "e3",
    };
    // 0.00<all>e+0 is another number unless all has one digit.
    const size_t choice = spelling_.Index(8);
    const std::string number = choice == 6 && all.size() != 1 ? spelled[0] : spelled[choice];
    const std::string before = spelling_.Index(4) == 0 ? " " : "",
                      after = spelling_.Index(4) == 0 ? "\n" : "";
    return before + sign + number + after;
  }
  std::string Attribute(const std::string& name, const std::string& value) {
    return " " + name + "=\"" + value + "\"";
  }

  std::string Origin() {
    switch (values_.Index(4)) {
      case 0:
        return "";
      case 1:
        return "<origin" + Attribute("xyz", Numbers(3, -900, 900)) + "/>";
      default:
        return "<origin" + Attribute("rpy", Numbers(3, -3000, 3000)) +
               Attribute("xyz", Numbers(3, -900, 900)) + "/>";
    }
  }
  std::string Link(int i) {
    if (i > 1 && values_.Index(5) == 0) return LinkXml(LinkName(i), "");
    std::string inertia = "<inertia";
    for (const char* entry : {"ixx", "iyy", "izz"}) inertia += Attribute(entry, Number(500, 3000));
    for (const char* entry : {"ixy", "ixz", "iyz"}) inertia += Attribute(entry, Number(-99, 99));
    return LinkXml(LinkName(i), "<inertial>" + Origin() + "<mass" + Attribute("value", Number(100, 9000)) +
                                    "/>" + inertia + "/></inertial>");
  }
  std::string Joint(int i) {
    static const char* const kTypes[] = {"revolute", "continuous", "prismatic", "fixed"};
    const std::string type = i == 1 ? "revolute" : kTypes[values_.Index(4)];
    std::string inside =
        Origin() + "<axis" + Attribute("xyz", Number(1, 900) + Blank() + Numbers(2, -900, 900)) + "/>";
    inside += "<limit" + (type == "continuous" ? "" : Attribute("lower", Number(-3000, 0))) +
              (type == "continuous" ? "" : Attribute("upper", Number(1, 3000))) +
              Attribute("effort", Number(1, 99000)) + Attribute("velocity", Number(1, 9000)) + "/>";
    if (values_.Index(2) == 0) {
      inside +=
          "<dynamics" + Attribute("damping", Number(0, 900)) + Attribute("friction", Number(0, 900)) + "/>";
    }
    if (i > 1 && values_.Index(4) == 0) {
      inside += MimicXml(JointName(static_cast<int>(1 + values_.Index(static_cast<uint64_t>(i - 1)))),
                         Attribute("multiplier", Number(1, 3000)) + Attribute("offset", Number(-500, 500)));
    }
    const int parent = static_cast<int>(values_.Index(static_cast<uint64_t>(i)));
    return JointXml(JointName(i), type, LinkName(parent), LinkName(i), inside);
  }

  Rng values_;
  Rng spelling_;
  bool is_odd_;
};

}  // namespace rg::testing_support

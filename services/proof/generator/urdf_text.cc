#include "services/proof/generator/urdf_text.h"

#include <cstdio>

namespace rg::proof {
namespace {

std::string Exactly(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%.9g", x);
  return text;
}

struct Span {
  size_t begin = std::string::npos,
         end = std::string::npos;  // behind the opening tag, before the closing one
  bool found() const { return begin != std::string::npos; }
};

Span Element(const std::string& text, const std::string& tag, const std::string& name) {
  const size_t open = text.find("<" + tag + " name=\"" + name + "\"");
  if (open == std::string::npos) return {};
  const size_t bracket = text.find('>', open);
  if (bracket == std::string::npos || text[bracket - 1] == '/') return {};
  return {bracket + 1, text.find("</" + tag + ">", bracket)};
}

// Replaces what is between `from` and `to` (both included) inside the span, or appends it.
std::string Replaced(const std::string& text, const Span& span, const std::string& from,
                     const std::string& to, const std::string& by) {
  const size_t begin = text.find(from, span.begin);
  if (begin == std::string::npos || begin >= span.end) {
    return text.substr(0, span.end) + by + text.substr(span.end);
  }
  const size_t end = text.find(to, begin) + to.size();
  return text.substr(0, begin) + by + text.substr(end);
}

}  // namespace

std::string InertialText(const Inertial& i) {
  const auto& m = i.inertia;
  return "<inertial>\n      <origin xyz=\"" + Exactly(i.com[0]) + " " + Exactly(i.com[1]) + " " +
         Exactly(i.com[2]) + "\" rpy=\"0 0 0\"/>\n      <mass value=\"" + Exactly(i.mass) +
         "\"/>\n      <inertia ixx=\"" + Exactly(m(0, 0)) + "\" iyy=\"" + Exactly(m(1, 1)) + "\" izz=\"" +
         Exactly(m(2, 2)) + "\" ixy=\"" + Exactly(m(0, 1)) + "\" ixz=\"" + Exactly(m(0, 2)) + "\" iyz=\"" +
         Exactly(m(1, 2)) + "\"/>\n    </inertial>";
}

std::string WithInertial(const std::string& urdf, const std::string& link, const Inertial& inertial) {
  const Span span = Element(urdf, "link", link);
  return span.found() ? Replaced(urdf, span, "<inertial>", "</inertial>", InertialText(inertial)) : urdf;
}

std::string WithLosses(const std::string& urdf, const std::string& joint, double damping, double friction) {
  const Span span = Element(urdf, "joint", joint);
  return span.found() ? Replaced(urdf, span, "<dynamics", "/>",
                                 "<dynamics damping=\"" + Exactly(damping) + "\" friction=\"" +
                                     Exactly(friction) + "\"/>")
                      : urdf;
}

}  // namespace rg::proof

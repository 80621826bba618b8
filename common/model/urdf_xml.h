// A URDF text as XML, and what people pass instead of a URDF told as what it is. Internal to the loader.
#pragma once

#include <tinyxml.h>

#include <string>
#include <string_view>

#include "common/base/status.h"

namespace rg::model {

// Well-formed XML with one root, <robot>, of at most 32 MB and 200 nested elements, that needs no
// expansion. Else one line with the remedy: an empty file, a git-lfs pointer, an HTML page, a binary
// file, UTF-16, SDF, MJCF, ${…} or xacro: elements (with the command that expands them).
Status ParseUrdfXml(const std::string& xml, const std::string& source_name, TiXmlDocument* document);

// "'text'" for a message: printable, on one line, at most 60 characters.
std::string Quoted(std::string_view text);

}  // namespace rg::model

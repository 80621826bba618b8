// <nlohmann/json.hpp> with the parts of reading and writing that every source would compile anew: they are
// compiled once, in json_parts.cc. Found before the library's own header by what links nlohmann_json.
#pragma once

#include_next <nlohmann/json.hpp>
#include <string>

#ifndef RG_JSON_PARTS
#define RG_JSON_PARTS extern template
#endif

namespace nlohmann::detail {
using RgTextInput = iterator_input_adapter<std::string::const_iterator>;
RG_JSON_PARTS class lexer<json, RgTextInput>;
RG_JSON_PARTS class parser<json, RgTextInput>;
RG_JSON_PARTS class json_sax_dom_parser<json>;
RG_JSON_PARTS class json_sax_dom_callback_parser<json>;
RG_JSON_PARTS class serializer<json>;
}  // namespace nlohmann::detail

// What the names of topics and columns say of what they hold.
#pragma once

#include <initializer_list>
#include <string>
#include <vector>

namespace rg::importing {

std::string Lower(std::string text);
// Its runs of letters and digits, in lower case.
std::vector<std::string> Words(const std::string& text);
bool HasWord(const std::vector<std::string>& words, std::initializer_list<const char*> some);
// A part of a word counts too: "commands", "JointGroupEffortController".
bool Contains(const std::string& text, std::initializer_list<const char*> some);

bool IsCommand(const std::string& name);
bool IsEffort(const std::string& name);

}  // namespace rg::importing

#define RG_JSON_PARTS template
#include <nlohmann/json.hpp>

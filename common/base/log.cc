#include "common/base/log.h"

#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>

#include <cstdlib>

namespace rg {

void InitLogging(const std::string& program, const std::string& level) {
  auto logger =
      std::make_shared<spdlog::logger>(program, std::make_shared<spdlog::sinks::stderr_color_sink_mt>());
  logger->set_formatter(std::make_unique<spdlog::pattern_formatter>("%Y-%m-%dT%H:%M:%S.%eZ %^%l%$ %n: %v",
                                                                    spdlog::pattern_time_type::utc));
  const char* from_environment = std::getenv("RG_LOG");
  const std::string chosen = !level.empty() ? level : from_environment ? from_environment : "info";
  logger->set_level(spdlog::level::from_str(chosen));
  spdlog::set_default_logger(std::move(logger));
}

}  // namespace rg

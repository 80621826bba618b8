// ROS 2 bags in SQLite (rosbag2's storage "sqlite3"): tables topics and messages, and, in newer files,
// message_definitions. Messages compressed one by one (rosbag2's compression mode "message", zstd) are
// read; whole files that are compressed are refused with the command that helps.
#pragma once

#include <string>
#include <string_view>

#include "services/importing/log.h"

namespace rg::importing {

bool LooksLikeSqlite(std::string_view bytes);
// `compressed`: each message is a zstd frame (metadata.yaml says so).
Status ReadDb3(const std::string& path, bool compressed, LogSink& sink, const ReadLimits& limits = {});
// The same off a database in memory.
Status ReadDb3Bytes(std::string_view bytes, const std::string& source_name, bool compressed, LogSink& sink,
                    const ReadLimits& limits = {});

}  // namespace rg::importing

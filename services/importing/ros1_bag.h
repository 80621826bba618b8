// ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0), read from front to back.
//
// librosbag-storage reads by the index at the end and follows its offsets unchecked: a damaged index
// crashes it, and a bag that was cut or not closed (.bag.active) is refused. Reading the chunks in order
// needs no index.
//
// Errors name the source and the byte; a file that ends within a record is read up to there, with a note.
#pragma once

#include <string>
#include <string_view>

#include "services/importing/log.h"

namespace rg::importing {

bool LooksLikeRos1Bag(std::string_view bytes);
Status ReadRos1Bag(std::string_view bytes, const std::string& source_name, LogSink& sink,
                   const ReadLimits& limits = {});

}  // namespace rg::importing

// What a log holds, found in one pass: topics, rates, and of messages with named joints what they say of
// each joint. The mapping is guessed from it, and checked against it.
#pragma once

#include <functional>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "services/importing/log.h"
#include "services/importing/log_file.h"

namespace rg::importing {

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  uint64_t count = 0;  // finite values seen
  void Take(double value);
  bool all_zero() const { return low == 0.0 && high == 0.0; }
};

// What JointState messages said of one name.
struct NamedJoint {
  Range position, velocity, effort;
};

struct TopicInfo {
  Topic topic;
  uint64_t messages = 0;
  int64_t first_ns = 0, last_ns = 0;         // log times
  std::string unreadable;                    // why no field of it can be read; empty if it can
  std::vector<std::string> fields;           // the message's own
  bool has_header = false;                   // header.stamp
  bool stamp_is_set = false;                 // not 0 in some message
  std::vector<std::string> names;            // of name or joint_names, in the order they came
  std::map<std::string, NamedJoint> joints;  // JointState only
  size_t list_length = 0;                    // of data in a MultiArray, the longest
  std::string text;                          // of a String of /realitygrad/…: the first

  double rate_hz() const;  // mean over the log
};

struct Inventory {
  std::vector<TopicInfo> topics;
  std::vector<std::string> notes;  // of the reader

  const TopicInfo* Find(const std::string& topic) const;
};

Result<Inventory> TakeInventory(const LogFile& file, const ProgressFn& progress);

}  // namespace rg::importing

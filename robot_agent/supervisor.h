// The agent's first process. It holds no arm: its child is the worker, whose executor runs rollouts. It arms
// and disarms, hears people and signals, and sees to it that nobody leaves while the arm moves.
//
//   first SIGTERM           drain: the rollout under way is finished and handed in
//   SIGINT, a second signal the arm is stopped (board.h), whatever else happens; only when it has been seen
//                           at rest, or after stop_patience_s, is the worker told to go at once
//   the agent is killed     the executor misses its beat and stops the arm; the worker drains
//
// Requests of the local socket, one word each: status, arm, disarm, stop, clear; answers are JSON objects
// with "ok" and, if not, "error".
#pragma once

#include <functional>
#include <string>

#include "common/base/status.h"
#include "robot_agent/board.h"
#include "robot_agent/safety/stop.h"

namespace rg::robot_agent {

struct SupervisorOptions {
  std::string spool_folder;
  std::string robot, driver;
  bool armed = false;  // from the start
  bool arm_ends_with_driver = false;
  bool dry_run = false;
  double stop_patience_s = LongestEnd();  // for a stop to be seen through
  double delivery_every_s = 2.0, delivery_age_s = 30.0;
};

// run_worker: in the child, its exit code becomes the agent's. deliver(least_age_s): in a thread of the
// parent; bundles that are younger stay, their tasks hand them in. Returns the exit code.
int Supervise(const SupervisorOptions& options, const std::function<int()>& run_worker,
              const std::function<void(double)>& deliver);

// The answer to one request, as above. For Supervise and tests.
std::string AnswerRequest(const SupervisorOptions& options, Board& board, const std::string& line);

}  // namespace rg::robot_agent

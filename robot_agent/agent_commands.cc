#include "robot_agent/agent_commands.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/clock.h"
#include "common/base/printf.h"
#include "robot_agent/local_socket.h"
#include "robot_agent/safety/latch.h"
#include "robot_agent/spool.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr int kExitOk = 0, kExitError = 1, kExitUsage = 2, kExitUnreachable = 6;
constexpr double kStopPatience = 10.0;  // s

constexpr char kUsage[] =
    "realitygrad agent WORD [--spool FOLDER] [--output table|json]\n"
    "  status   how the arm, the agent and its spool are\n"
    "  watch    the same, again and again [--every SECONDS]\n"
    "  arm      rollouts may begin\n"
    "  disarm   none may; one under way is stopped\n"
    "  stop     stop the arm now, wait until it was seen at rest, and disarm\n"
    "  clear    a person has looked at an arm whose stop was not confirmed\n"
    "The agent is found by its spool folder (default: REALITYGRAD_AGENT_SPOOL or realitygrad-spool; of\n"
    "`realitygrad run`: the run's folder, /spool). No coordinator is needed.\n";

struct Words {
  std::string verb, spool, output = "table";
  double every_s = 0.5;
  bool help = false;
};

Result<Words> Parse(const std::vector<std::string>& arguments) {
  Words words;
  words.verb = arguments[1];
  const char* folder = std::getenv("REALITYGRAD_AGENT_SPOOL");
  words.spool = folder != nullptr ? folder : "realitygrad-spool";
  for (size_t i = 2; i < arguments.size(); ++i) {
    std::string name = arguments[i], value;
    const size_t equals = name.find('=');
    if (name == "--help" || name == "-h") {
      words.help = true;
      continue;
    }
    if (equals != std::string::npos) {
      value = name.substr(equals + 1);
      name = name.substr(0, equals);
    } else if (i + 1 < arguments.size()) {
      value = arguments[++i];
    } else {
      return InvalidError("agent " + words.verb + ": " + name + " needs a value, or is unknown");
    }
    if (name == "--spool") {
      words.spool = value;
    } else if (name == "--output" || name == "-o") {
      words.output = value;
    } else if (name == "--every") {
      words.every_s = std::atof(value.c_str());
    } else {
      return InvalidError("agent " + words.verb + ": unknown flag " + name);
    }
  }
  if (words.output != "table" && words.output != "json")
    return InvalidError("agent " + words.verb + ": --output is \"" + words.output +
                        "\", needs table or json");
  if (!(words.every_s >= 0.05 && words.every_s <= 3600))
    return InvalidError("agent " + words.verb + ": --every needs 0.05 to 3600 seconds");
  return words;
}

int Fail(const Status& status) {
  std::cerr << "realitygrad agent: " << status.message() << "\n";
  if (status.code() == StatusCode::kInvalid) return kExitUsage;
  return status.code() == StatusCode::kUnavailable ? kExitUnreachable : kExitError;
}

// An answer with "ok": false is an error.
Result<std::string> Ask(const Words& words, const std::string& line) {
  RG_ASSIGN_OR_RETURN(const std::string text, AskLocally(words.spool, line));
  const json answer = json::parse(text, nullptr, false);
  if (!answer.is_object()) return DataLossError("the agent's answer is no JSON");
  if (!answer.value("ok", false)) return FailedPreconditionError(answer.value("error", "refused"));
  return text;
}

void Show(const Words& words, const std::string& text) {
  if (words.output == "json") {
    std::cout << text << std::flush;
  } else {
    std::cout << StatusText(text) << std::flush;
  }
}

// Waits until nobody moves the arm any more, and says whether it was seen at rest.
Result<std::string> StopAndSee(const Words& words) {
  RG_ASSIGN_OR_RETURN(std::string text, Ask(words, "stop"));
  const double give_up = RealClock().SteadySeconds() + kStopPatience;
  while (json::parse(text).value("phase", "") != "idle") {
    if (RealClock().SteadySeconds() > give_up)
      return FailedPreconditionError(
          "the arm was told to stop and has not been seen at rest: use the red button");
    usleep(50'000);
    RG_ASSIGN_OR_RETURN(text, Ask(words, "status"));
  }
  const json status = json::parse(text);
  if (!status.value("latched", false)) return text;
  return FailedPreconditionError("the stop was not confirmed: " + status["latch"].value("reason", "") +
                                 "; look at the arm, then: realitygrad agent clear");
}

// Also without an agent: the file is all there is then.
Result<std::string> ClearLatch(const Words& words) {
  auto answer = Ask(words, "clear");
  if (answer.ok() || answer.status().code() != StatusCode::kUnavailable) return answer;
  RG_ASSIGN_OR_RETURN(const auto nobody_else, Spool::Open(words.spool, 1.0));
  RG_RETURN_IF_ERROR(Latch(words.spool).Clear());
  return json{{"ok", true}, {"latched", false}}.dump() + "\n";
}

volatile std::sig_atomic_t watching = 1;

int Watch(const Words& words) {
  std::signal(SIGINT, [](int) { watching = 0; });
  const bool screen = words.output == "table" && isatty(STDOUT_FILENO);
  while (watching) {
    const auto text = Ask(words, "status");
    if (!text.ok()) return Fail(text.status());
    if (screen) std::cout << "\033[H\033[2J";
    Show(words, *text);
    usleep(static_cast<useconds_t>(1e6 * words.every_s));
  }
  return kExitOk;
}

// "[....|.....]": where `value` is between the ends; '!' outside.
std::string Bar(double value, double lower, double upper) {
  constexpr int kWidth = 21;
  std::string bar(kWidth, '.');
  if (!(upper > lower)) return "[" + bar + "]";
  const double share = (value - lower) / (upper - lower);
  const int at = std::clamp(static_cast<int>(share * kWidth), 0, kWidth - 1);
  bar[static_cast<size_t>(at)] = share >= 0.0 && share <= 1.0 ? '#' : '!';
  return "[" + bar + "]";
}

double Number(const json& object, const char* name) {
  return object.contains(name) && object[name].is_number() ? object[name].get<double>() : std::nan("");
}

std::string JointLines(const json& status) {
  std::string text;
  if (!status.contains("joints") || status["joints"].empty()) return text;
  text += Printf("  %-16s %-23s %9s  %9s of %-7s %9s of %s\n", "joint", "position", "rad", "rad/s", "limit",
                 "N·m", "limit");
  for (const json& joint : status["joints"]) {
    const double q = Number(joint, "q"), lower = Number(joint, "lower"), upper = Number(joint, "upper");
    text += Printf("  %-16s %-23s %9.4f  %9.4f of %-7.3g %9.3f of %.3g\n", joint.value("name", "").c_str(),
                   Bar(q, lower, upper).c_str(), q, Number(joint, "v"), Number(joint, "velocity"),
                   Number(joint, "command"), Number(joint, "torque"));
  }
  return text;
}

}  // namespace

std::string StatusText(const std::string& status_json) {
  const json status = json::parse(status_json, nullptr, false);
  if (!status.is_object()) return "no status\n";
  const json none = json::object();
  const json spool = status.value("spool", none), end = status.value("last_end", none);
  std::string text;
  text += Printf("%s (%s): %s%s, %s, %s mode\n", status.value("robot", "?").c_str(),
                 status.value("driver", "?").c_str(), status.value("armed", false) ? "armed" : "disarmed",
                 status.value("dry_run", false) ? ", dry run" : "", status.value("phase", "?").c_str(),
                 status.value("mode", "?").c_str());
  if (status.value("latched", false)) {
    const json latch = status.value("latch", none);
    text += "LATCHED since " + latch.value("since", "?") + ", rollout " + latch.value("rollout", "?") + ": " +
            latch.value("reason", "?") + "\n  look at the arm, then: realitygrad agent clear\n";
  }
  if (const std::string rollout = status.value("rollout", ""); !rollout.empty())
    text += Printf(
        "rollout %s: %.4g Hz, %.0f cycles, %.0f deadlines missed, latest wake-up %.0f us, state %.1f ms "
        "old\n",
        rollout.c_str(), Number(status, "rate_hz"), Number(status, "ticks"),
        Number(status, "missed_deadlines"), Number(status, "lateness_max_us"),
        1e-3 * Number(status, "state_age_us"));
  text += JointLines(status);
  if (const std::string reason = end.value("reason", ""); !reason.empty())
    text += "last end: " + reason +
            (end.value("detail", "").empty() ? "" : " (" + end.value("detail", "") + ")") + "\n";
  text += Printf("spool: %.0f being recorded, %.0f waiting, %.0f broken, in ", Number(spool, "recording"),
                 Number(spool, "waiting"), Number(spool, "broken")) +
          spool.value("folder", "?") + "\n";
  return text;
}

std::optional<int> RunAgentCommand(const std::vector<std::string>& arguments) {
  static const std::set<std::string> kVerbs{"status", "watch", "arm", "disarm", "stop", "clear"};
  if (arguments.size() < 2 || !kVerbs.contains(arguments[1])) return std::nullopt;
  const auto words = Parse(arguments);
  if (!words.ok()) return Fail(words.status());
  if (words->help) {
    std::cout << kUsage;
    return kExitOk;
  }
  if (words->verb == "watch") return Watch(*words);
  const auto text = words->verb == "stop"    ? StopAndSee(*words)
                    : words->verb == "clear" ? ClearLatch(*words)
                                             : Ask(*words, words->verb);
  if (!text.ok()) return Fail(text.status());
  Show(*words, *text);
  return kExitOk;
}

}  // namespace rg::robot_agent

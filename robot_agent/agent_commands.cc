#include "robot_agent/agent_commands.h"

#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>
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
    "  watch    the same, again and again [--every SECONDS]; the space bar is `stop`\n"
    "  arm      rollouts may begin\n"
    "  disarm   none may; one under way is stopped\n"
    "  stop     stop the arm now, wait until it was seen at rest, and disarm\n"
    "  clear    a person has looked at an arm whose stop was not confirmed\n"
    "The agent is found by its spool folder (default: REALITYGRAD_AGENT_SPOOL or\n"
    "~/.local/state/realitygrad/spool; of `realitygrad run`: the run's folder, /spool). No coordinator is needed.\n";

struct Words {
  std::string verb, spool, output = "table";
  double every_s = 0.5;
  bool help = false;
};

Result<Words> Parse(const std::vector<std::string>& arguments) {
  Words words;
  words.verb = arguments[1];
  const char* folder = std::getenv("REALITYGRAD_AGENT_SPOOL");
  words.spool = folder != nullptr ? folder : DefaultSpoolFolder();
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

// The terminal's other screen, without a cursor, as long as it lives.
class Screen {
 public:
  Screen() {
    std::cout << "\033[?1049h\033[?25l";
    hears_keys_ = tcgetattr(STDIN_FILENO, &before_) == 0;
    termios keys = before_;
    keys.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
    if (hears_keys_) tcsetattr(STDIN_FILENO, TCSANOW, &keys);
  }
  ~Screen() {
    if (hears_keys_) tcsetattr(STDIN_FILENO, TCSANOW, &before_);
    std::cout << "\033[?25h\033[?1049l" << std::flush;
  }
  // Waits so long for the space bar; other keys end the waiting.
  bool StopKey(double seconds) const {
    pollfd key{hears_keys_ ? STDIN_FILENO : -1, POLLIN, 0};
    char pressed = 0;
    return poll(&key, 1, static_cast<int>(1e3 * seconds)) > 0 && read(STDIN_FILENO, &pressed, 1) == 1 && pressed == ' ';
  }
  // Line over line: nothing flickers.
  void Draw(const std::string& text) {
    std::string drawn = "\033[H";
    for (const char c : text) drawn += c == '\n' ? "\033[K\n" : std::string(1, c);
    std::cout << drawn << "\033[J" << std::flush;
  }

 private:
  termios before_{};
  bool hears_keys_ = false;
};

// On a terminal it outlives the agent, which may be started again; in a pipe it ends with it.
int Watch(const Words& words) {
  std::signal(SIGINT, [](int) { watching = 0; });
  std::signal(SIGTERM, [](int) { watching = 0; });
  std::optional<Screen> screen;
  while (watching) {
    const auto text = Ask(words, "status");
    if (!screen && !text.ok()) return Fail(text.status());
    if (!screen && words.output == "table" && isatty(STDOUT_FILENO)) screen.emplace();
    if (!screen) {
      Show(words, *text);
    } else {
      const std::string now = FormatWallTime(RealClock().WallNanos()).substr(11, 8);
      screen->Draw(now + " UTC, space bar: stop the arm; Ctrl-C ends the watching, not the agent\n\n" +
                   (text.ok() ? StatusText(*text) : text.status().message() + "\n"));
    }
    if (!screen) {
      usleep(static_cast<useconds_t>(1e6 * words.every_s));
    } else if (screen->StopKey(words.every_s)) {
      (void)Ask(words, "stop").ok();  // the next picture says how it went
    }
  }
  return kExitOk;
}

// "[....#....]": where `value` is between the ends; '!' outside.
std::string Bar(double value, double lower, double upper) {
  constexpr int kWidth = 13;
  std::string bar(kWidth, '.');
  if (!(upper > lower)) return "[" + bar + "]";
  const double share = (value - lower) / (upper - lower);
  const int at = std::clamp(static_cast<int>(share * kWidth), 0, kWidth - 1);
  bar[static_cast<size_t>(at)] = share >= 0.0 && share <= 1.0 ? '#' : '!';
  return "[" + bar + "]";
}

// "[###.....]": how much of its limit; '!' beyond.
std::string Share(double value, double limit) {
  constexpr int kWidth = 8;
  if (!(limit > 0.0) || !std::isfinite(value)) return "[" + std::string(kWidth, '.') + "]";
  const double share = std::abs(value) / limit;
  const int filled = std::clamp(static_cast<int>(std::ceil(share * kWidth - 0.5)), 0, kWidth);
  return "[" + std::string(filled, share <= 1.0 ? '#' : '!') + std::string(kWidth - filled, '.') + "]";
}

double Number(const json& object, const char* name) {
  return object.contains(name) && object[name].is_number() ? object[name].get<double>() : std::nan("");
}

// Fits a terminal of 80 columns.
std::string JointLines(const json& status) {
  std::string text;
  if (!status.contains("joints") || status["joints"].empty()) return text;
  text += "joint       position in its box  rad  speed        rad/s  torque         N·m\n";
  for (const json& joint : status["joints"]) {
    const double q = Number(joint, "q"), v = Number(joint, "v"), torque = Number(joint, "command");
    text += Printf("%-11.11s %s %8.4f  %s %7.3f  %s %7.2f\n", joint.value("name", "").c_str(),
                   Bar(q, Number(joint, "lower"), Number(joint, "upper")).c_str(), q,
                   Share(v, Number(joint, "velocity")).c_str(), v,
                   Share(torque, Number(joint, "torque")).c_str(), torque);
  }
  return text;
}

std::string RolloutLines(const json& status) {
  const std::string rollout = status.value("rollout", "");
  if (rollout.empty()) return "";
  std::string text = (status.value("phase", "") == "idle" ? "last rollout " : "rollout ") + rollout + "\n";
  return text + Printf("  %.4g Hz, %.0f cycles, %.0f late; latest wake-up %.2f ms, state %.1f ms old\n",
                       Number(status, "rate_hz"), Number(status, "ticks"), Number(status, "missed_deadlines"),
                       1e-3 * Number(status, "lateness_max_us"), 1e-3 * Number(status, "state_age_us"));
}

}  // namespace

std::string StatusText(const std::string& status_json) {
  const json status = json::parse(status_json, nullptr, false);
  if (!status.is_object()) return "no status\n";
  const json none = json::object();
  const json spool = status.value("spool", none), end = status.value("last_end", none);
  const std::string phase = status.value("phase", "?");
  const double seen = Number(status, "seen_s_ago");
  std::string text;
  text += Printf("%s (%s): %s%s, %s, %s mode", status.value("robot", "?").c_str(),
                 status.value("driver", "?").c_str(), status.value("armed", false) ? "armed" : "disarmed",
                 status.value("dry_run", false) ? ", dry run" : "", phase.c_str(),
                 status.value("mode", "?").c_str());
  // An arm at rest is not asked for its state.
  if (phase == "idle" && std::isfinite(seen)) text += Printf(" when seen %.0f s ago", seen);
  text += "\n";
  if (status.value("latched", false)) {
    const json latch = status.value("latch", none);
    text += "LATCHED since " + latch.value("since", "?") + ", rollout " + latch.value("rollout", "?") + ":\n  " +
            latch.value("reason", "?") + "\n  look at the arm, then: realitygrad agent clear\n";
  }
  text += RolloutLines(status) + JointLines(status);
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
  if (arguments.size() < 2 || arguments[1].empty() || arguments[1][0] == '-') return std::nullopt;
  if (!kVerbs.contains(arguments[1]))
    return Fail(InvalidError("there is no command '" + arguments[1] + "': status, watch, arm, disarm, stop, clear, or flags (--help)"));
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

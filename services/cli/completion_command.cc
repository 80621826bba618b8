// `completion bash|zsh`: a script that completes commands, flags and job numbers, made from the commands
// themselves.
#include <CLI/CLI.hpp>
#include <functional>

#include "services/cli/commands.h"
#include "services/cli/context.h"

namespace rg::cli {
namespace {

// "job show" -> its App, depth first. The root's name is empty.
void ForEachCommand(const CLI::App& app, const std::string& path,
                    const std::function<void(const std::string&, const CLI::App&)>& body) {
  body(path, app);
  for (const CLI::App* sub : app.get_subcommands({}))
    ForEachCommand(*sub, path.empty() ? sub->get_name() : path + " " + sub->get_name(), body);
}

struct Word {
  std::string text, help;
};

std::vector<Word> Subcommands(const CLI::App& app) {
  std::vector<Word> words;
  for (const CLI::App* sub : app.get_subcommands({}))
    words.push_back({sub->get_name(), sub->get_description()});
  return words;
}

std::vector<Word> Options(const CLI::App& app) {
  std::vector<Word> words;
  for (const CLI::Option* option : app.get_options()) {
    for (const std::string& name : option->get_lnames())
      words.push_back({"--" + name, option->get_description()});
  }
  return words;
}

// Those of the program itself go everywhere.
std::vector<Word> AllOptions(const CLI::App& root, const CLI::App& app) {
  std::vector<Word> words = Options(app);
  if (&app == &root) return words;
  for (const Word& word : Options(root)) {
    if (word.text != "--help" && word.text != "--version") words.push_back(word);
  }
  return words;
}

std::string Joined(const std::vector<Word>& words) {
  std::string text;
  for (const Word& word : words) text += (text.empty() ? "" : " ") + word.text;
  return text;
}

// The commands whose first argument is the number of a job.
bool TakesJob(const std::string& path) { return path.rfind("job ", 0) == 0; }

constexpr char kBashBegin[] =
    R"bash(# bash completion of realitygrad; realitygrad completion bash > ~/.local/share/bash-completion/completions/realitygrad
_realitygrad() {
  local cur=${COMP_WORDS[COMP_CWORD]} prev=${COMP_WORDS[COMP_CWORD-1]} path="" word i commands="" options="" jobs=""
  for ((i = 1; i < COMP_CWORD; ++i)); do
    word="$path${path:+ }${COMP_WORDS[i]}"
    case "$word" in
)bash";
constexpr char kBashMiddle[] = R"bash() path=$word ;;
    esac
  done
  case "$prev" in
    --output|-o) COMPREPLY=($(compgen -W "table json quiet" -- "$cur")); return ;;
  esac
  case "$path" in
)bash";
constexpr char kBashEnd[] = R"bash(  esac
  if [[ $cur == -* ]]; then
    COMPREPLY=($(compgen -W "$options" -- "$cur"))
  elif [[ -n $jobs ]]; then
    COMPREPLY=($(compgen -W "last all $(timeout "${REALITYGRAD_COMPLETION_S:-1}" "${COMP_WORDS[0]}" jobs --limit 50 --output quiet 2>/dev/null)" -- "$cur"))
  else
    COMPREPLY=($(compgen -W "$commands" -- "$cur"))
  fi
}
complete -o default -F _realitygrad realitygrad
)bash";

std::string Bash(const CLI::App& root) {
  std::string paths, cases;
  ForEachCommand(root, "", [&](const std::string& path, const CLI::App& app) {
    if (!path.empty()) paths += (paths.empty() ? "      '" : "|'") + path + "'";
    cases += "    '" + path + "') commands='" + Joined(Subcommands(app)) + "' options='" +
             Joined(AllOptions(root, app)) + "'" + (TakesJob(path) ? " jobs=yes" : "") + " ;;\n";
  });
  return kBashBegin + paths + kBashMiddle + cases + kBashEnd;
}

// Inside single quotes of an array for _describe: colons part word and help.
std::string ZshWord(const Word& word) {
  std::string help;
  for (const char c : word.help.substr(0, word.help.find('\n'))) {
    if (c == '\'') {
      help += "’";
    } else if (c == ':') {
      help += "\\:";
    } else {
      help += c;
    }
  }
  return "'" + word.text + ":" + help + "'";
}

std::string ZshWords(const std::vector<Word>& words) {
  std::string text;
  for (const Word& word : words) text += " " + ZshWord(word);
  return text;
}

std::string Zsh(const CLI::App& root) {
  std::string paths, cases;
  ForEachCommand(root, "", [&](const std::string& path, const CLI::App& app) {
    if (!path.empty()) paths += (paths.empty() ? "      '" : "|'") + path + "'";
    cases += "    '" + path + "') commands=(" + ZshWords(Subcommands(app)) + " ); options=(" +
             ZshWords(AllOptions(root, app)) + " )" + (TakesJob(path) ? "; jobs=yes" : "") + " ;;\n";
  });
  return "#compdef realitygrad\n# zsh completion of realitygrad; realitygrad completion zsh > "
         "\"${fpath[1]}/_realitygrad\"\n"
         "_realitygrad() {\n"
         "  local where=\"\" word i jobs=\"\"\n"
         "  local -a commands options ids\n"
         "  for ((i = 2; i < CURRENT; ++i)); do\n"
         "    word=\"$where${where:+ }${words[i]}\"\n"
         "    case \"$word\" in\n" +
         paths +
         ") where=$word ;;\n    esac\n  done\n"
         "  if [[ ${words[CURRENT-1]} == (--output|-o) ]]; then compadd table json quiet; return; fi\n"
         "  case \"$where\" in\n" +
         cases +
         "  esac\n"
         "  if [[ $PREFIX == -* ]]; then\n    _describe -o option options\n"
         "  elif [[ -n $jobs ]]; then\n"
         "    ids=(last all $(timeout 1 ${words[1]} jobs --limit 50 --output quiet 2>/dev/null)); compadd -a "
         "ids\n"
         "  elif (( ${#commands} )); then\n    _describe command commands\n"
         "  else\n    _files\n  fi\n}\n"
         "if [[ $zsh_eval_context[-1] == loadautofunc ]]; then _realitygrad \"$@\"; else compdef "
         "_realitygrad realitygrad; fi\n";
}

}  // namespace

void AddCompletionCommand(CLI::App& app) {
  CLI::App* completion = app.add_subcommand("completion", "Print a script that completes commands in a shell")
                             ->require_subcommand(1);
  completion->add_subcommand("bash", "source <(realitygrad completion bash)")->callback([&app] {
    Print(Bash(app));
  });
  completion->add_subcommand("zsh", "source <(realitygrad completion zsh)")->callback([&app] {
    Print(Zsh(app));
  });
}

}  // namespace rg::cli

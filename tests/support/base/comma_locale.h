// A process in a country of decimal commas, for as long as it lives: the C locale and the global C++
// locale write 1,5. Uses an installed locale, or has localedef (packages libc-bin and locales) make
// de_DE in a folder of its own. Tests only; not thread-safe.
#pragma once

#include <clocale>
#include <cstdlib>
#include <filesystem>
#include <locale>
#include <string>

namespace rg::testing_support {

class CommaLocale {
 public:
  CommaLocale() : c_before_(std::setlocale(LC_ALL, nullptr)) {
    // What a German C++ locale does, without one being installed.
    cpp_before_ = std::locale::global(std::locale(std::locale::classic(), new Punctuation));
    is_c_locale_set_ = SetInstalled() || SetMade();
  }
  ~CommaLocale() {
    std::locale::global(cpp_before_);
    std::setlocale(LC_ALL, c_before_.c_str());
    if (folder_.empty()) return;
    unsetenv("LOCPATH");
    std::filesystem::remove_all(folder_);
  }
  CommaLocale(const CommaLocale&) = delete;
  CommaLocale& operator=(const CommaLocale&) = delete;

  // Whether strtod and printf take commas now; the C++ locale always does.
  bool is_c_locale_set() const { return is_c_locale_set_; }

 private:
  struct Punctuation : std::numpunct<char> {
    char do_decimal_point() const override { return ','; }
    char do_thousands_sep() const override { return '.'; }
    std::string do_grouping() const override { return "\3"; }
  };

  static bool HasComma() { return *std::localeconv()->decimal_point == ','; }

  static bool SetInstalled() {
    for (const char* name : {"de_DE.UTF-8", "de_DE", "fr_FR.UTF-8", "it_IT.UTF-8", "es_ES.UTF-8"}) {
      if (std::setlocale(LC_ALL, name) != nullptr && HasComma()) return true;
    }
    return false;
  }

  bool SetMade() {
    std::string pattern = (std::filesystem::temp_directory_path() / "locale_XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) return false;
    folder_ = pattern;
    const std::string make = "localedef -i de_DE -f UTF-8 " + folder_ + "/de_DE.UTF-8 >/dev/null 2>&1";
    if (std::system(make.c_str()) != 0) return false;
    setenv("LOCPATH", folder_.c_str(), 1);
    return SetInstalled();
  }

  std::string c_before_;
  std::locale cpp_before_;
  std::string folder_;  // of the locale made here
  bool is_c_locale_set_ = false;
};

}  // namespace rg::testing_support

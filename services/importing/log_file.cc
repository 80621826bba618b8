#include "services/importing/log_file.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "common/base/file.h"
#include "services/importing/mcap.h"
#include "services/importing/ros1_bag.h"
#include "services/importing/ros2_db3.h"

namespace rg::importing {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kForgetStep = uint64_t{16} << 20;
constexpr std::string_view kZstdMagic = "\x28\xB5\x2F\xFD";

bool IsText(std::string_view bytes) {
  return !bytes.empty() && std::none_of(bytes.begin(), bytes.end(), [](char c) {
    return static_cast<unsigned char>(c) < ' ' && c != '\n' && c != '\r' && c != '\t';
  });
}

// "value" of a line "  key: value", without quotes; empty where the line is another.
std::string_view YamlValue(std::string_view line, std::string_view key) {
  const size_t at = line.find(key);
  if (at == std::string_view::npos || line.substr(0, at).find_first_not_of(" -") != std::string_view::npos)
    return {};
  std::string_view value = line.substr(at + key.size());
  if (value.empty() || value.front() != ':') return {};
  value.remove_prefix(1);
  const char* const blanks = " \t\r\"'";
  const size_t first = value.find_first_not_of(blanks);
  if (first == std::string_view::npos) return {};
  return value.substr(first, value.find_last_not_of(blanks) - first + 1);
}

// What metadata.yaml says that matters here.
struct BagMetadata {
  std::vector<std::string> files;
  std::string compression_mode;
};

BagMetadata ParseMetadata(std::string_view text) {
  BagMetadata metadata;
  bool in_files = false;
  while (!text.empty()) {
    const size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (line.find("relative_file_paths:") != std::string_view::npos) {
      in_files = true;
    } else if (const size_t dash = line.find("- ");
               in_files && dash != std::string_view::npos && line.find(':') == std::string_view::npos) {
      std::string_view name = line.substr(dash + 2);
      const char* const blanks = " \t\r\"'";
      const size_t first = name.find_first_not_of(blanks);
      if (first != std::string_view::npos)
        metadata.files.emplace_back(name.substr(first, name.find_last_not_of(blanks) - first + 1));
    } else {
      in_files = false;
      const std::string_view mode = YamlValue(line, "compression_mode");
      if (!mode.empty()) metadata.compression_mode = mode;
    }
  }
  return metadata;
}

Result<LogFile> OpenFolder(const std::string& path) {
  LogFile file{path, {}, {}, false};
  const fs::path metadata_path = fs::path(path) / "metadata.yaml";
  std::error_code error;
  if (fs::exists(metadata_path, error)) {
    RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(metadata_path.string()));
    const BagMetadata metadata = ParseMetadata(text);
    for (std::string name : metadata.files) {
      // Old versions wrote the path from where the recording was started.
      if (!fs::exists(fs::path(path) / name, error)) name = fs::path(name).filename().string();
      file.parts.push_back((fs::path(path) / name).string());
    }
    file.compressed_messages =
        metadata.compression_mode == "MESSAGE" || metadata.compression_mode == "message";
    if (file.parts.empty())
      return InvalidError(metadata_path.string() + ": relative_file_paths: names no file");
  } else {
    bool bags = false;
    for (const auto& entry : fs::directory_iterator(path, error)) {
      const std::string extension = entry.path().extension();
      bags = bags || extension == ".bag";
      if (extension == ".db3" || extension == ".mcap") file.parts.push_back(entry.path().string());
    }
    std::sort(file.parts.begin(), file.parts.end());
    if (file.parts.empty())
      return InvalidError(path + ": a folder without metadata.yaml, .db3 or .mcap files" +
                          (bags ? "; give its bags one by one: " + path + "/*.bag" : ""));
  }
  return file;
}

// Gives a part's topics the numbers that the whole log has for them.
class PartSink final : public LogSink {
 public:
  PartSink(LogSink& whole, TopicTable& topics, MappedFile* mapped)
      : whole_(whole), topics_(topics), mapped_(mapped) {}
  Status OnTopic(const Topic& topic) override {
    RG_ASSIGN_OR_RETURN(const size_t number, topics_.Add(topic));
    numbers_.push_back(number);
    return Status::Ok();
  }
  Status OnMessage(const Message& message) override {
    return whole_.OnMessage({numbers_[message.topic], message.log_ns, message.bytes});
  }
  void OnNote(const std::string& note) override { whole_.OnNote(note); }
  void OnProgress(uint64_t done, uint64_t total) override {
    if (mapped_ != nullptr) mapped_->Forget(done);
    whole_.OnProgress(done, total);
  }

 private:
  LogSink& whole_;
  TopicTable& topics_;
  MappedFile* mapped_;
  std::vector<size_t> numbers_;
};

}  // namespace

Result<MappedFile> MappedFile::Open(const std::string& path) {
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) return NotFoundError(path + ": " + std::strerror(errno));
  struct stat about {};
  if (::fstat(descriptor, &about) != 0 || !S_ISREG(about.st_mode)) {
    ::close(descriptor);
    return InvalidError(path + ": is a folder, a device or a pipe, not a file");
  }
  const auto size = static_cast<size_t>(about.st_size);
  void* data = size == 0 ? nullptr : ::mmap(nullptr, size, PROT_READ, MAP_PRIVATE, descriptor, 0);
  const int error = errno;
  ::close(descriptor);
  if (data == MAP_FAILED) return UnavailableError(path + ": " + std::strerror(error));
  return MappedFile(static_cast<const char*>(data), size);
}

MappedFile::MappedFile(MappedFile&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}

MappedFile::~MappedFile() {
  if (data_ != nullptr) ::munmap(const_cast<char*>(data_), size_);
}

void MappedFile::Forget(uint64_t end) {
  if (end < forgotten_ + kForgetStep || end > size_) return;
  const uint64_t whole_pages = end / kForgetStep * kForgetStep;
  ::madvise(const_cast<char*>(data_) + forgotten_, whole_pages - forgotten_, MADV_DONTNEED);
  forgotten_ = whole_pages;
}

Result<Container> ContainerOf(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const MappedFile file, MappedFile::Open(path));
  const std::string_view start = file.bytes().substr(0, 4096);
  if (LooksLikeRos1Bag(start)) return Container::kRos1Bag;
  if (LooksLikeMcap(start)) return Container::kMcap;
  if (LooksLikeSqlite(start)) return Container::kDb3;
  if (start.substr(0, kZstdMagic.size()) == kZstdMagic)
    return InvalidError(path + ": is compressed as a whole: run 'zstd -d " + path + "' first");
  if (IsText(start)) return Container::kCsv;
  return InvalidError(path + ": is no ROS 1 bag, ROS 2 bag, MCAP file or CSV");
}

Result<LogFile> OpenLog(const std::string& path) {
  LogFile file{path, {path}, {}, false};
  std::error_code error;
  if (fs::is_directory(path, error)) {
    RG_ASSIGN_OR_RETURN(file, OpenFolder(path));
  } else if (!fs::exists(path, error)) {
    return NotFoundError(path + ": " + (error ? error.message() : "no such file"));
  }
  for (const std::string& part : file.parts) {
    RG_ASSIGN_OR_RETURN(const Container container, ContainerOf(part));
    if (container == Container::kCsv && file.parts.size() > 1)
      return InvalidError(part + ": is no part of a ROS 2 bag");
    file.containers.push_back(container);
  }
  return file;
}

Status ReadLog(const LogFile& file, LogSink& sink) {
  const ReadLimits limits;
  TopicTable topics(sink, limits);
  for (size_t i = 0; i < file.parts.size(); ++i) {
    const std::string& path = file.parts[i];
    if (file.containers[i] == Container::kDb3) {
      PartSink part(sink, topics, nullptr);
      RG_RETURN_IF_ERROR(ReadDb3(path, file.compressed_messages, part, limits));
      continue;
    }
    RG_ASSIGN_OR_RETURN(MappedFile mapped, MappedFile::Open(path));
    PartSink part(sink, topics, &mapped);
    RG_RETURN_IF_ERROR(file.containers[i] == Container::kMcap
                           ? ReadMcap(mapped.bytes(), path, part, limits)
                           : ReadRos1Bag(mapped.bytes(), path, part, limits));
  }
  return Status::Ok();
}

}  // namespace rg::importing

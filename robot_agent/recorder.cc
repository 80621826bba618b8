#include "robot_agent/recorder.h"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>

#include "common/base/file.h"

namespace rg::robot_agent {
namespace {

constexpr uint32_t kMagic = 0x43524752;  // "RGRC"
constexpr uint32_t kMetadata = 1, kSample = 2, kEnd = 3;
constexpr size_t kHeader = 16;
constexpr uint32_t kMaxPayload = 64u << 20;
constexpr size_t kSampleHead = 5 * 8;

constexpr std::array<uint32_t, 256> MakeCrcTable() {
  std::array<uint32_t, 256> table{};
  for (uint32_t i = 0; i < 256; ++i) {
    uint32_t c = i;
    for (int k = 0; k < 8; ++k) c = (c >> 1) ^ (0x82F63B78u & (0u - (c & 1u)));
    table[i] = c;
  }
  return table;
}

uint32_t Crc32c(const char* bytes, size_t count, uint32_t crc) {
  static constexpr auto kTable = MakeCrcTable();
  for (size_t i = 0; i < count; ++i) crc = (crc >> 8) ^ kTable[(crc ^ static_cast<uint8_t>(bytes[i])) & 255u];
  return crc;
}

template <class T>
void Put(std::string* out, T value) {
  out->append(reinterpret_cast<const char*>(&value), sizeof value);
}

template <class T>
T Get(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

uint32_t RecordCrc(uint32_t type, const char* payload, uint32_t length) {
  const uint32_t head[2] = {type, length};
  const uint32_t crc = Crc32c(reinterpret_cast<const char*>(head), sizeof head, 0xFFFFFFFFu);
  return ~Crc32c(payload, length, crc);
}

void EncodeSample(const Sample& sample, int n, std::string* out) {
  out->clear();
  Put(out, sample.tick);
  Put(out, sample.time_ns);
  Put(out, sample.stamp_ns);
  Put(out, sample.sequence);
  Put(out, sample.flags);
  for (const JointArray* values : {&sample.q, &sample.v, &sample.effort, &sample.command, &sample.sent})
    out->append(reinterpret_cast<const char*>(values->data()), n * sizeof(double));
}

bool DecodeSample(const char* bytes, size_t length, Sample* sample) {
  if (length < kSampleHead || (length - kSampleHead) % (5 * sizeof(double)) != 0) return false;
  const size_t n = (length - kSampleHead) / (5 * sizeof(double));
  if (n > kMaxJoints) return false;
  sample->tick = Get<int64_t>(bytes);
  sample->time_ns = Get<int64_t>(bytes + 8);
  sample->stamp_ns = Get<int64_t>(bytes + 16);
  sample->sequence = Get<uint64_t>(bytes + 24);
  sample->flags = Get<uint64_t>(bytes + 32);
  const char* at = bytes + kSampleHead;
  for (JointArray* values : {&sample->q, &sample->v, &sample->effort, &sample->command, &sample->sent}) {
    std::memcpy(values->data(), at, n * sizeof(double));
    at += n * sizeof(double);
  }
  return true;
}

Status WriteAll(int file, const char* bytes, size_t count) {
  while (count > 0) {
    const ssize_t written = write(file, bytes, count);
    if (written < 0 && errno == EINTR) continue;
    if (written < 0)
      return ResourceExhaustedError(std::string("cannot write the recording: ") + std::strerror(errno));
    bytes += written;
    count -= written;
  }
  return Status::Ok();
}

}  // namespace

Result<std::unique_ptr<Recorder>> Recorder::Start(const std::string& path, const std::string& metadata_json,
                                                  int joints, const RecorderOptions& options) {
  RG_CHECK(joints > 0 && joints <= kMaxJoints) << joints;
  std::error_code ignored;
  std::filesystem::create_directories(std::filesystem::path(path).parent_path(), ignored);
  const int file = open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0644);
  if (file < 0) return UnavailableError("cannot create " + path + ": " + std::strerror(errno));
  if (options.reserve_bytes > 0 &&
      fallocate(file, FALLOC_FL_KEEP_SIZE, 0, static_cast<off_t>(options.reserve_bytes)) != 0 &&
      errno != EOPNOTSUPP && errno != ENOSYS) {
    const std::string why = std::strerror(errno);
    close(file);
    unlink(path.c_str());
    return ResourceExhaustedError("cannot reserve " + std::to_string(options.reserve_bytes) + " bytes for " +
                                  path + ": " + why);
  }
  std::unique_ptr<Recorder> recorder(new Recorder(file, joints, options));
  recorder->Append(kMetadata, metadata_json);
  recorder->Sync();
  if (!recorder->failure_.ok()) return recorder->failure_.WithPrefix(path);
  recorder->thread_ = std::thread([r = recorder.get()] { r->Run(); });
  return recorder;
}

Recorder::Recorder(int file, int joints, const RecorderOptions& options)
    : file_(file), joints_(joints), options_(options), ring_(options.ring_capacity) {}

Recorder::~Recorder() {
  StopThread();
  close(file_);
}

uint64_t Recorder::SampleBytes(int joints) { return kHeader + kSampleHead + 5 * sizeof(double) * joints; }

void Recorder::Record(const Sample& sample) {
  if (!ring_.Push(sample)) ok_.store(false, std::memory_order_relaxed);
}

Status Recorder::Finish(const std::string& end_json) {
  StopThread();
  Drain();
  Append(kEnd, end_json);
  Sync();
  if (failure_.ok() && !ok()) return ResourceExhaustedError("the recorder fell behind and lost samples");
  return failure_;
}

void Recorder::StopThread() {
  {
    const std::lock_guard lock(stop_mutex_);
    stop_ = true;
  }
  stop_signal_.notify_one();
  if (thread_.joinable()) thread_.join();
}

void Recorder::Run() {
  using std::chrono::duration;
  using std::chrono::steady_clock;
  auto last_sync = steady_clock::now();
  std::unique_lock lock(stop_mutex_);
  while (!stop_signal_.wait_for(lock, duration<double>(options_.poll_s), [this] { return stop_; })) {
    Drain();
    if (duration<double>(steady_clock::now() - last_sync).count() < options_.sync_s) continue;
    Sync();
    last_sync = steady_clock::now();
  }
}

void Recorder::Drain() {
  Sample sample;
  std::string payload;
  while (ring_.Pop(&sample)) {
    EncodeSample(sample, joints_, &payload);
    Append(kSample, payload);
  }
}

void Recorder::Append(uint32_t type, const std::string& payload) {
  if (!failure_.ok()) return;
  const auto length = static_cast<uint32_t>(payload.size());
  scratch_.clear();
  Put(&scratch_, kMagic);
  Put(&scratch_, type);
  Put(&scratch_, length);
  Put(&scratch_, RecordCrc(type, payload.data(), length));
  scratch_ += payload;
  failure_ = WriteAll(file_, scratch_.data(), scratch_.size());
  if (!failure_.ok()) ok_.store(false, std::memory_order_relaxed);
}

void Recorder::Sync() {
  if (!failure_.ok() || fdatasync(file_) == 0) return;
  failure_ = ResourceExhaustedError(std::string("cannot sync the recording: ") + std::strerror(errno));
  ok_.store(false, std::memory_order_relaxed);
}

Result<RawRecording> ReadRawRecording(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path));
  RawRecording raw;
  bool has_metadata = false;
  size_t at = 0;
  while (bytes.size() - at >= kHeader) {
    const char* head = bytes.data() + at;
    const auto type = Get<uint32_t>(head + 4), length = Get<uint32_t>(head + 8);
    if (Get<uint32_t>(head) != kMagic || length > kMaxPayload || bytes.size() - at - kHeader < length) break;
    const char* payload = head + kHeader;
    if (RecordCrc(type, payload, length) != Get<uint32_t>(head + 12)) break;
    Sample sample;
    if (type == kMetadata) {
      raw.metadata_json.assign(payload, length);
      has_metadata = true;
    } else if (type == kSample && DecodeSample(payload, length, &sample)) {
      raw.samples.push_back(sample);
    } else if (type == kEnd) {
      raw.end_json.emplace(payload, length);
    }
    at += kHeader + length;
  }
  raw.torn_bytes = bytes.size() - at;
  if (!has_metadata) return DataLossError(path + ": no readable metadata record");
  return raw;
}

}  // namespace rg::robot_agent

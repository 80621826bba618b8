// Bytes of a shard, version 1. All integers and doubles little-endian:
//   "RGSHARD\n"  u32 version
//   u64 seed, first; u32 count; f64 interval_s; u32 n; n × (u32 length, name)
//   u32 kinds, kinds × u64 failures; u32 m, m × u64 unfilled
//   u32 trajectories, each: u64 slot; u32 draw, iterations, K; f64 goal_error; then f64 goal n, final_q n,
//     final_v n, q n·K, v n·K, torque n·K (sample by sample)
//   64 hexadecimal digits: SHA-256 of all bytes before
// Frozen: a change makes a new version.
#include <bit>
#include <cstring>

#include "common/base/hash.h"
#include "services/trajectories/shard.h"

namespace rg::trajectories {
namespace {

static_assert(std::endian::native == std::endian::little, "shards are written as the machine stores them");
constexpr std::string_view kMagic = "RGSHARD\n";
constexpr uint32_t kVersion = 1;
constexpr size_t kDigestLength = 64;
constexpr uint32_t kMaxJoints = 1024;
constexpr uint32_t kMaxSamples = 1u << 20;

class Writer {
 public:
  template <class T>
  void Put(T value) {
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void PutText(std::string_view text) {
    Put(static_cast<uint32_t>(text.size()));
    bytes_.append(text);
  }
  template <class M>
  void PutMatrix(const M& m) {
    bytes_.append(reinterpret_cast<const char*>(m.data()), m.size() * sizeof(double));
  }
  std::string& bytes() { return bytes_; }

 private:
  std::string bytes_;
};

class Reader {
 public:
  explicit Reader(std::string_view bytes) : bytes_(bytes) {}
  bool ok() const { return ok_; }
  bool at_end() const { return position_ == bytes_.size(); }

  template <class T>
  T Get() {
    T value{};
    Copy(&value, sizeof value);
    return value;
  }
  std::string GetText(uint32_t limit) {
    const uint32_t length = Get<uint32_t>();
    if (length > limit) ok_ = false;
    std::string text(ok_ ? length : 0, '\0');
    Copy(text.data(), text.size());
    return text;
  }
  // A count of items of at least `size` bytes each that can still follow.
  uint32_t GetCount(size_t size) {
    const uint32_t count = Get<uint32_t>();
    if (ok_ && count > (bytes_.size() - position_) / size) ok_ = false;
    return ok_ ? count : 0;
  }
  template <class M>
  void GetMatrix(int rows, int cols, M* m) {
    if (ok_ && static_cast<size_t>(rows) * cols > (bytes_.size() - position_) / sizeof(double)) ok_ = false;
    if (!ok_) return;
    m->resize(rows, cols);
    Copy(m->data(), m->size() * sizeof(double));
  }

 private:
  void Copy(void* to, size_t size) {
    if (!ok_ || size > bytes_.size() - position_) {
      ok_ = false;
      return;
    }
    std::memcpy(to, bytes_.data() + position_, size);
    position_ += size;
  }
  std::string_view bytes_;
  size_t position_ = 0;
  bool ok_ = true;
};

void PutTrajectory(const Trajectory& t, Writer* out) {
  out->Put(t.slot);
  out->Put(t.draw);
  out->Put(t.iterations);
  out->Put(static_cast<uint32_t>(t.num_samples()));
  out->Put(t.goal_error);
  out->PutMatrix(t.goal);
  out->PutMatrix(t.final_q);
  out->PutMatrix(t.final_v);
  out->PutMatrix(t.q);
  out->PutMatrix(t.v);
  out->PutMatrix(t.torque);
}

bool GetTrajectory(Reader* in, int n, Trajectory* t) {
  t->slot = in->Get<uint64_t>();
  t->draw = in->Get<uint32_t>();
  t->iterations = in->Get<uint32_t>();
  const uint32_t samples = in->Get<uint32_t>();
  if (samples > kMaxSamples) return false;
  t->goal_error = in->Get<double>();
  in->GetMatrix(n, 1, &t->goal);
  in->GetMatrix(n, 1, &t->final_q);
  in->GetMatrix(n, 1, &t->final_v);
  in->GetMatrix(n, samples, &t->q);
  in->GetMatrix(n, samples, &t->v);
  in->GetMatrix(n, samples, &t->torque);
  return in->ok() && t->q.allFinite() && t->v.allFinite() && t->torque.allFinite() && t->goal.allFinite();
}

}  // namespace

std::string SerializeShard(const Shard& shard) {
  Writer out;
  out.bytes().append(kMagic);
  out.Put(kVersion);
  out.Put(shard.seed);
  out.Put(shard.first);
  out.Put(shard.count);
  out.Put(shard.interval_s);
  out.Put(static_cast<uint32_t>(shard.joints.size()));
  for (const std::string& joint : shard.joints) out.PutText(joint);
  out.Put(static_cast<uint32_t>(kFailureKinds));
  for (uint64_t count : shard.failures) out.Put(count);
  out.Put(static_cast<uint32_t>(shard.unfilled.size()));
  for (uint64_t slot : shard.unfilled) out.Put(slot);
  out.Put(static_cast<uint32_t>(shard.trajectories.size()));
  for (const Trajectory& t : shard.trajectories) PutTrajectory(t, &out);
  out.bytes() += Sha256Hex(out.bytes());
  return std::move(out.bytes());
}

Result<Shard> ParseShard(std::string_view bytes, const std::string& source) {
  if (bytes.substr(0, kMagic.size()) != kMagic) return InvalidError(source + ": not a shard of trajectories");
  if (bytes.size() < kMagic.size() + sizeof(uint32_t) + kDigestLength)
    return DataLossError(source + ": shard is cut off after " + std::to_string(bytes.size()) + " bytes");
  Reader in(bytes.substr(kMagic.size(), bytes.size() - kMagic.size() - kDigestLength));
  const uint32_t version = in.Get<uint32_t>();
  if (version != kVersion)
    return InvalidError(source + ": shard version " + std::to_string(version) + ", this program reads " +
                        std::to_string(kVersion));
  const size_t body = bytes.size() - kDigestLength;
  if (Sha256Hex(bytes.substr(0, body)) != bytes.substr(body))
    return DataLossError(source + ": shard checksum does not match its bytes");

  Shard shard;
  shard.seed = in.Get<uint64_t>();
  shard.first = in.Get<uint64_t>();
  shard.count = in.Get<uint32_t>();
  shard.interval_s = in.Get<double>();
  const uint32_t n = in.GetCount(sizeof(uint32_t));
  if (!in.ok() || n == 0 || n > kMaxJoints) return DataLossError(source + ": shard has a wrong joint count");
  for (uint32_t i = 0; i < n; ++i) shard.joints.push_back(in.GetText(4096));
  const uint32_t kinds = in.Get<uint32_t>();
  if (!in.ok() || kinds != kFailureKinds) return DataLossError(source + ": shard has wrong failure counts");
  for (uint64_t& count : shard.failures) count = in.Get<uint64_t>();
  shard.unfilled.resize(in.GetCount(sizeof(uint64_t)));
  for (uint64_t& slot : shard.unfilled) slot = in.Get<uint64_t>();
  shard.trajectories.resize(in.GetCount(3 * sizeof(uint64_t)));
  for (size_t i = 0; i < shard.trajectories.size(); ++i)
    if (!GetTrajectory(&in, static_cast<int>(n), &shard.trajectories[i]))
      return DataLossError(source + ": trajectory " + std::to_string(i) + " of the shard is malformed");
  if (!in.ok() || !in.at_end()) return DataLossError(source + ": shard has missing or extra bytes");
  return shard;
}

}  // namespace rg::trajectories

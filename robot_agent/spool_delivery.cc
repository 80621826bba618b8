#include "robot_agent/spool_delivery.h"

#include <nlohmann/json.hpp>

#include "common/base/log.h"
#include "robot_agent/rollout/rollout_bundle.h"
#include "robot_agent/spool.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

std::string MetadataOfBundle(const std::string& bytes) {
  const auto bundle = rollouts::UnpackBundle(bytes);
  if (!bundle.ok() || !bundle->contains("rollout.json")) return "{}";
  const json rollout = json::parse(bundle->at("rollout.json"), nullptr, false);
  return rollout.is_discarded() ? "{}" : rollout.dump();
}

}  // namespace

int SalvageRecordings(Spool& spool) {
  const auto ids = spool.Salvage(FinishFile);
  for (const auto& id : ids) spdlog::warn("recording {} was cut off by a crash; what it holds is kept", id);
  return static_cast<int>(ids.size());
}

Result<int> DeliverSpool(const std::string& spool_folder, const BundleDeliverer& deliver,
                         double least_age_s) {
  if (const auto idle = Spool::Open(spool_folder); idle.ok()) SalvageRecordings(**idle);
  RG_ASSIGN_OR_RETURN(const auto spool, Spool::OpenToDeliver(spool_folder));
  const auto with_metadata = [&](const std::string& id, const std::string& bundle) {
    return deliver(id, bundle, MetadataOfBundle(bundle));
  };
  return spool->Deliver(with_metadata, least_age_s);
}

}  // namespace rg::robot_agent

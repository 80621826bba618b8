#include "services/jobs/fit_messages.h"

#include <map>

namespace rg::jobs {

namespace pb = ::realitygrad::v1;
using diagnosis::Candidate;
using diagnosis::FitRequest;
using diagnosis::FitResult;
using diagnosis::FitSetting;
using effects::EffectSpec;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

template <class Repeated>
void Put(const VectorXd& from, Repeated* to) {
  to->Assign(from.data(), from.data() + from.size());
}
template <class Repeated>
VectorXd Taken(const Repeated& from) {
  return Eigen::Map<const VectorXd>(from.data(), from.size());
}

void Put(const MatrixXd& from, pb::FitMatrix* to) {
  to->set_rows(static_cast<uint32_t>(from.rows()));
  to->mutable_values()->Assign(from.data(), from.data() + from.size());
}
MatrixXd Taken(const pb::FitMatrix& from) {
  const Eigen::Index rows = from.rows();
  return Eigen::Map<const MatrixXd>(from.values().data(), rows, rows == 0 ? 0 : from.values_size() / rows);
}

template <class Message>
void PutEffects(const std::vector<EffectSpec>& specs, Message* to) {
  for (const EffectSpec& spec : specs) {
    pb::FitEffect* effect = to->add_effects();
    effect->set_id(spec.id);
    for (const std::string& joint : spec.joints) effect->add_joints(joint);
    for (const auto& [owner, values] : spec.values) {
      for (const auto& [name, value] : values) {
        pb::FitEffect::Value* row = effect->add_values();
        row->set_owner(owner), row->set_name(name), row->set_value(value);
      }
    }
    effect->mutable_options()->insert(spec.options.begin(), spec.options.end());
  }
}

template <class Message>
std::vector<EffectSpec> Effects(const Message& from) {
  std::vector<EffectSpec> specs;
  for (const pb::FitEffect& effect : from.effects()) {
    EffectSpec spec;
    spec.id = effect.id();
    spec.joints.assign(effect.joints().begin(), effect.joints().end());
    for (const auto& row : effect.values()) spec.values[row.owner()][row.name()] = row.value();
    spec.options.insert(effect.options().begin(), effect.options().end());
    specs.push_back(std::move(spec));
  }
  return specs;
}

Result<std::shared_ptr<const Candidate>> StartOf(const pb::FitStart& start, const FitSetting& setting) {
  Candidate from = diagnosis::Unfitted(setting, Effects(start), start.base());
  const size_t windows = setting.data.windows.size();
  if (from.plant == nullptr || start.values_size() != from.plant->parameters().size() ||
      (start.states_size() > 0 && static_cast<size_t>(start.states_size()) != windows))
    return InvalidError("fit: the model to start at is not one of these recordings");
  from.fit.ok = true;
  from.fit.values = Taken(start.values()), from.fit.step_s = start.step_s();
  for (const pb::FitMatrix& states : start.states()) from.fit.states.push_back(Taken(states));
  for (size_t w = 0; w < from.fit.states.size(); ++w) {
    const MatrixXd& states = from.fit.states[w];
    if (states.rows() != from.plant->num_states() ||
        states.cols() != static_cast<Eigen::Index>(setting.data.windows[w].t.size()))
      return InvalidError("fit: the states to start at are not those of these recordings");
  }
  return std::make_shared<const Candidate>(std::move(from));
}

}  // namespace

pb::FitBatch BatchOf(const std::vector<FitRequest>& requests, const diagnosis::FitData& data) {
  pb::FitBatch batch;
  batch.set_fit_window_s(data.nodes.window_s);
  batch.mutable_recordings()->Assign(data.places.begin(), data.places.end());
  std::map<const Candidate*, uint32_t> starts;
  for (const FitRequest& request : requests) {
    pb::FitRequest* fit = batch.add_fits();
    PutEffects(request.specs, fit);
    fit->set_base(request.base);
    fit->set_iterations(static_cast<uint32_t>(request.options.iterations));
    fit->set_more_iterations(static_cast<uint32_t>(request.options.more_iterations));
    fit->set_still_falling(request.options.still_falling);
    fit->set_to_beat(request.options.to_beat);
    fit->set_noise_scale(request.options.noise_scale);
    fit->set_step_s(request.options.step_s);
    fit->set_piece_s(request.piece_s);
    fit->set_pieces_alone(request.pieces_alone);
    fit->mutable_places()->Assign(request.places.begin(), request.places.end());
    if (request.from == nullptr) continue;
    const auto [at, fresh] =
        starts.try_emplace(request.from.get(), static_cast<uint32_t>(batch.starts_size() + 1));
    fit->set_start(at->second);
    if (!fresh) continue;
    pb::FitStart* start = batch.add_starts();
    PutEffects(request.from->specs, start);
    start->set_base(request.from->base);
    Put(request.from->fit.values, start->mutable_values());
    start->set_step_s(request.from->fit.step_s);
    for (const MatrixXd& states : request.from->fit.states) Put(states, start->add_states());
  }
  return batch;
}

Result<FitRequest> RequestOf(const pb::FitBatch& batch, uint32_t index, const FitSetting& setting) {
  if (index >= static_cast<uint32_t>(batch.fits_size()))
    return InvalidError("fit: the batch has no fit " + std::to_string(index));
  const pb::FitRequest& fit = batch.fits(static_cast<int>(index));
  FitRequest request;
  request.specs = Effects(fit);
  request.base = fit.base();
  request.options.iterations = static_cast<int>(fit.iterations());
  request.options.more_iterations = static_cast<int>(fit.more_iterations());
  request.options.still_falling = fit.still_falling();
  request.options.to_beat = fit.to_beat();
  request.options.noise_scale = fit.noise_scale();
  request.options.step_s = fit.step_s();
  request.piece_s = fit.piece_s();
  request.pieces_alone = fit.pieces_alone();
  request.places.assign(fit.places().begin(), fit.places().end());
  for (const uint32_t place : request.places) {
    if (place >= setting.data.windows.size())
      return InvalidError("fit: the recordings have no window " + std::to_string(place));
  }
  if (fit.start() == 0) return request;
  if (fit.start() > static_cast<uint32_t>(batch.starts_size()))
    return InvalidError("fit: the batch has no start " + std::to_string(fit.start()));
  RG_ASSIGN_OR_RETURN(request.from, StartOf(batch.starts(static_cast<int>(fit.start()) - 1), setting));
  return request;
}

pb::FitReply ReplyOf(const FitResult& fit) {
  pb::FitReply reply;
  reply.set_ok(fit.ok);
  Put(fit.values, reply.mutable_values());
  Put(fit.theta, reply.mutable_theta());
  Put(fit.stddev, reply.mutable_stddev());
  reply.mutable_window_chi2()->Assign(fit.window_chi2.begin(), fit.window_chi2.end());
  for (const MatrixXd& states : fit.states) Put(states, reply.add_states());
  Put(fit.information, reply.mutable_information());
  reply.set_chi2(fit.chi2);
  reply.set_prior_cost(fit.prior_cost);
  reply.set_evidence(fit.evidence);
  reply.set_work(fit.work);
  reply.set_rows(static_cast<uint32_t>(fit.rows));
  reply.set_iterations(static_cast<uint32_t>(fit.iterations));
  reply.set_step_s(fit.step_s);
  return reply;
}

FitResult FitOf(const pb::FitReply& reply) {
  FitResult fit;
  fit.ok = reply.ok();
  fit.values = Taken(reply.values());
  fit.theta = Taken(reply.theta());
  fit.stddev = Taken(reply.stddev());
  fit.window_chi2.assign(reply.window_chi2().begin(), reply.window_chi2().end());
  for (const pb::FitMatrix& states : reply.states()) fit.states.push_back(Taken(states));
  fit.information = Taken(reply.information());
  fit.chi2 = reply.chi2();
  fit.prior_cost = reply.prior_cost();
  fit.evidence = reply.evidence();
  fit.work = reply.work();
  fit.rows = static_cast<int>(reply.rows());
  fit.iterations = static_cast<int>(reply.iterations());
  fit.step_s = reply.step_s();
  return fit;
}

}  // namespace rg::jobs

#include "worker/task_registry.h"

namespace rg::worker {

const InputArtifact* TaskInput::Find(std::string_view name) const {
  for (const InputArtifact& input : inputs) {
    if (input.name == name) return &input;
  }
  return nullptr;
}

Result<const InputArtifact*> TaskInput::Require(std::string_view name) const {
  if (const InputArtifact* input = Find(name)) return input;
  return InvalidError("task " + task_name + " (" + kind + "): input '" + std::string(name) + "' is missing");
}

std::vector<const InputArtifact*> TaskInput::All(std::string_view name) const {
  std::vector<const InputArtifact*> found;
  for (const InputArtifact& input : inputs) {
    if (input.name == name) found.push_back(&input);
  }
  return found;
}

bool TaskFailureIsRetryable(StatusCode code) {
  switch (code) {
    case StatusCode::kInvalid:
    case StatusCode::kNotFound:
    case StatusCode::kAlreadyExists:
    case StatusCode::kFailedPrecondition:
    case StatusCode::kPermissionDenied:
      return false;
    default:
      return true;
  }
}

void TaskRegistry::Register(std::string kind, TaskFunction function, double least_grace_s) {
  RG_CHECK(function != nullptr) << "task kind " << kind << " without a function";
  if (least_grace_s > 0.0) least_grace_s_[kind] = least_grace_s;
  const bool inserted = functions_.emplace(kind, std::move(function)).second;
  RG_CHECK(inserted) << "task kind " << kind << " registered twice";
}

const TaskFunction* TaskRegistry::Find(std::string_view kind) const {
  const auto found = functions_.find(kind);
  return found == functions_.end() ? nullptr : &found->second;
}

std::vector<std::string> TaskRegistry::kinds() const {
  std::vector<std::string> names;
  for (const auto& [name, function] : functions_) names.push_back(name);
  return names;
}

RecordingTaskContext::RecordingTaskContext(std::string scratch_folder, std::string initial_checkpoint)
    : checkpoint(std::move(initial_checkpoint)), scratch_folder_(std::move(scratch_folder)) {}

Status RecordingTaskContext::SaveCheckpoint(std::string bytes) {
  checkpoint = std::move(bytes);
  ++checkpoints_saved;
  return Status::Ok();
}

}  // namespace rg::worker

#include "coordinator/server/job_compiler.h"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>

#include <algorithm>
#include <map>
#include <unordered_map>

#include "common/base/hash.h"
#include "common/base/utf8.h"
#include "common/store/artifact_store.h"
#include "coordinator/server/policy.h"

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;

constexpr uint32_t kMaxAttempts = 1000;
constexpr size_t kMaxNameBytes = 200;
constexpr int kMaxJobsBefore = 1000;
constexpr double kMaxSeconds = 1e9, kMaxWeight = 1e12;

class Compiler {
 public:
  Compiler(const pb::JobSpec& spec, TaskId parent, const std::set<std::string>& robot_kinds)
      : spec_(spec), parent_(parent), robot_kinds_(robot_kinds) {}

  Result<CompiledJob> Run() {
    RG_RETURN_IF_ERROR(CheckSize());
    RG_RETURN_IF_ERROR(CheckHead());
    RG_RETURN_IF_ERROR(CheckTerms());
    RG_RETURN_IF_ERROR(IndexNames());
    auto plan = std::make_shared<JobPlan>();
    auto specs = std::make_shared<TaskSpecs>();
    CopyHead(*plan);
    plan->tasks.reserve(static_cast<size_t>(spec_.tasks_size()));
    for (const pb::TaskSpec& task : spec_.tasks()) {
      TaskPlan& out = plan->tasks.emplace_back();
      const Status status = CompileTask(task, out);
      if (!status.ok()) return status.WithPrefix("task '" + VisibleText(task.name()) + "'");
      pb::TaskSpec stored = task;
      stored.set_at_most_once(out.at_most_once);
      specs->push_back(stored.SerializeAsString());
    }
    RG_RETURN_IF_ERROR(CheckNoCycle(*plan));
    return CompiledJob{plan, specs};
  }

 private:
  Status CheckSize() const {
    if (spec_.tasks_size() == 0) return InvalidError("a job needs at least one task");
    if (static_cast<uint32_t>(spec_.tasks_size()) >= kMaxTasksPerJob) {
      return InvalidError("a job may have at most " + std::to_string(kMaxTasksPerJob - 1) +
                          " tasks, this one has " + std::to_string(spec_.tasks_size()));
    }
    return Status::Ok();
  }

  // What every listing shows.
  static Status CheckShown(const std::string& what, const std::string& text) {
    constexpr size_t kMostBytes = 128;
    RG_RETURN_IF_ERROR(CheckPlain(what, text));
    if (text.size() <= kMostBytes) return Status::Ok();
    return InvalidError(what + " has " + std::to_string(text.size()) + " bytes, at most " + std::to_string(kMostBytes));
  }

  Status CheckHead() const {
    constexpr int kMostLabels = 32;
    RG_RETURN_IF_ERROR(CheckShown("the job's kind", spec_.kind()));
    RG_RETURN_IF_ERROR(CheckShown("the job's name", spec_.name()));
    RG_RETURN_IF_ERROR(CheckPlain("the job's submitter", spec_.submitted_by()));
    for (const std::string& tag : spec_.tags()) RG_RETURN_IF_ERROR(CheckShown("a tag of the job", tag));
    if (static_cast<int>(spec_.labels().size()) > kMostLabels)
      return InvalidError("the job has " + std::to_string(spec_.labels().size()) + " labels, at most " + std::to_string(kMostLabels));
    for (const auto& [key, value] : spec_.labels()) {
      RG_RETURN_IF_ERROR(CheckShown("a label of the job", key));
      RG_RETURN_IF_ERROR(CheckShown("the label " + key + " of the job", value));
    }
    return Status::Ok();
  }

  // When it may start, and for how long it may run.
  Status CheckTerms() const {
    RG_RETURN_IF_ERROR(CheckPriority(spec_.priority()));
    if (!(spec_.time_limit_s() >= 0.0 && spec_.time_limit_s() <= kMaxSeconds))
      return InvalidError("the job's time limit of " + std::to_string(spec_.time_limit_s()) +
                          " s is not between 0 and 1e9");
    if (spec_.after_jobs().empty()) return Status::Ok();
    if (parent_ != 0) return InvalidError("a job that a task submits may not come after others");
    if (spec_.after_jobs_size() > kMaxJobsBefore)
      return InvalidError("a job may come after at most " + std::to_string(kMaxJobsBefore) + " others");
    for (const JobId id : spec_.after_jobs()) {
      if (id <= 0) return InvalidError("there is no job " + std::to_string(id) + " to come after");
    }
    return Status::Ok();
  }

  static Status CheckTaskIsPlain(const pb::TaskSpec& task) {
    RG_RETURN_IF_ERROR(CheckPlain("its name", task.name()));
    RG_RETURN_IF_ERROR(CheckPlain("its stage", task.stage()));
    RG_RETURN_IF_ERROR(CheckPlain("its kind", task.kind()));
    for (const std::string& tag : task.required_tags()) RG_RETURN_IF_ERROR(CheckPlain("its tag", tag));
    return Status::Ok();
  }

  Status IndexNames() {
    for (int i = 0; i < spec_.tasks_size(); ++i) {
      const pb::TaskSpec& task = spec_.tasks(i);
      if (task.name().empty() || task.name().size() > kMaxNameBytes) {
        return InvalidError("task " + std::to_string(i) + ": its name must have 1 to " +
                            std::to_string(kMaxNameBytes) + " characters");
      }
      if (!by_name_.emplace(task.name(), static_cast<uint32_t>(i)).second) {
        return InvalidError("two tasks are named '" + VisibleText(task.name()) + "'");
      }
      by_stage_[StageOf(task)].push_back(static_cast<uint32_t>(i));
    }
    return Status::Ok();
  }

  static const std::string& StageOf(const pb::TaskSpec& task) {
    return task.stage().empty() ? task.kind() : task.stage();
  }

  void CopyHead(JobPlan& plan) const {
    plan.kind = spec_.kind();
    plan.name = spec_.name();
    plan.submitted_by = spec_.submitted_by();
    plan.parent = parent_;
    plan.spec_json = spec_.spec_json();
    plan.priority = spec_.priority();
    plan.time_limit_ns = static_cast<int64_t>(1e9 * spec_.time_limit_s());
    const std::set<JobId> after(spec_.after_jobs().begin(), spec_.after_jobs().end());
    plan.after_jobs.assign(after.begin(), after.end());
    plan.tags.assign(spec_.tags().begin(), spec_.tags().end());
    plan.labels.insert(spec_.labels().begin(), spec_.labels().end());
  }

  Status CompileTask(const pb::TaskSpec& task, TaskPlan& out) {
    RG_RETURN_IF_ERROR(CheckTaskIsPlain(task));
    if (task.kind().empty()) return InvalidError("it has no kind");
    if (!(task.weight() >= 0.0 && task.weight() <= kMaxWeight))
      return InvalidError("weight " + std::to_string(task.weight()) + " is not between 0 and 1e12");
    RG_RETURN_IF_ERROR(CheckPriority(task.priority()));
    if (!(task.timeout_s() >= 0.0 && task.timeout_s() <= kMaxSeconds))
      return InvalidError("timeout_s " + std::to_string(task.timeout_s()) + " is not between 0 and 1e9");
    if (task.max_attempts() > kMaxAttempts) {
      return InvalidError("max_attempts " + std::to_string(task.max_attempts()) + " is above " +
                          std::to_string(kMaxAttempts));
    }
    out.name = task.name();
    out.kind = task.kind();
    out.stage = StageOf(task);
    out.required_tags.assign(task.required_tags().begin(), task.required_tags().end());
    std::sort(out.required_tags.begin(), out.required_tags.end());
    out.priority = spec_.priority() + task.priority();
    out.max_attempts = task.max_attempts() == 0 ? 3 : task.max_attempts();
    out.crash_limit = task.crash_limit() == 0 ? 3 : task.crash_limit();
    out.at_most_once = robot_kinds_.count(task.kind()) > 0;
    out.weight = task.weight() == 0.0 ? 1.0 : task.weight();
    return CollectParents(task, out);
  }

  // A parent is optional for the task only if every mention of it is.
  Status CollectParents(const pb::TaskSpec& task, TaskPlan& out) const {
    std::map<uint32_t, bool> parents;
    const auto add = [&](uint32_t index, bool optional) {
      const auto [entry, is_new] = parents.emplace(index, optional);
      if (!is_new) entry->second = entry->second && optional;
    };
    for (const std::string& name : task.after()) {
      const auto found = by_name_.find(name);
      if (found == by_name_.end())
        return InvalidError("it comes after '" + name + "', which is no task of the job");
      add(found->second, false);
    }
    for (const pb::InputSpec& input : task.inputs()) {
      const Status status = CollectInput(input, add);
      if (!status.ok()) return status.WithPrefix("input '" + input.name() + "'");
    }
    for (const auto& [index, optional] : parents) {
      if (spec_.tasks(static_cast<int>(index)).name() == task.name())
        return InvalidError("it depends on itself");
      out.parents.push_back({index, optional});
    }
    return Status::Ok();
  }

  template <class Add>
  Status CollectInput(const pb::InputSpec& input, const Add& add) const {
    switch (input.source_case()) {
      case pb::InputSpec::kArtifact:
        return store::CheckSha256Text(input.artifact());
      case pb::InputSpec::kTaskOutput: {
        const auto found = by_name_.find(input.task_output().task());
        if (found == by_name_.end()) {
          return InvalidError("'" + input.task_output().task() + "' is no task of the job");
        }
        add(found->second, input.optional());
        return Status::Ok();
      }
      case pb::InputSpec::kStageOutputs: {
        const auto found = by_stage_.find(input.stage_outputs().stage());
        if (found == by_stage_.end()) {
          return InvalidError("'" + input.stage_outputs().stage() + "' is no stage of the job");
        }
        for (const uint32_t index : found->second) add(index, input.optional());
        return Status::Ok();
      }
      case pb::InputSpec::SOURCE_NOT_SET:
        break;
    }
    return InvalidError("it has no source");
  }

  static Status CheckNoCycle(const JobPlan& plan) {
    std::vector<uint32_t> open(plan.tasks.size());
    std::vector<std::vector<uint32_t>> children(plan.tasks.size());
    std::vector<uint32_t> ready;
    for (uint32_t i = 0; i < plan.tasks.size(); ++i) {
      open[i] = static_cast<uint32_t>(plan.tasks[i].parents.size());
      if (open[i] == 0) ready.push_back(i);
      for (const ParentEdge& edge : plan.tasks[i].parents) children[edge.parent].push_back(i);
    }
    size_t reached = 0;
    while (!ready.empty()) {
      const uint32_t i = ready.back();
      ready.pop_back();
      ++reached;
      for (const uint32_t child : children[i]) {
        if (--open[child] == 0) ready.push_back(child);
      }
    }
    if (reached == plan.tasks.size()) return Status::Ok();
    const auto stuck = std::find_if(open.begin(), open.end(), [](uint32_t count) { return count > 0; });
    return InvalidError("the tasks depend on each other in a circle, among them '" +
                        plan.tasks[static_cast<size_t>(stuck - open.begin())].name + "'");
  }

  const pb::JobSpec& spec_;
  const TaskId parent_;
  const std::set<std::string>& robot_kinds_;
  std::unordered_map<std::string, uint32_t> by_name_;
  std::unordered_map<std::string, std::vector<uint32_t>> by_stage_;
};

}  // namespace

Status CheckPriority(int32_t priority) {
  if (priority >= -kMaxPriority && priority <= kMaxPriority) return Status::Ok();
  return InvalidError("the priority " + std::to_string(priority) + " is not between -" +
                      std::to_string(kMaxPriority) + " and " + std::to_string(kMaxPriority));
}

Result<CompiledJob> CompileJob(const pb::JobSpec& spec, TaskId parent,
                               const std::set<std::string>& robot_kinds) {
  return Compiler(spec, parent, robot_kinds).Run();
}

std::string ContentOf(const pb::JobSpec& spec) {
  pb::JobSpec asked = spec;
  asked.clear_submitted_by();
  asked.clear_spec_json();
  std::string bytes;
  {
    google::protobuf::io::StringOutputStream stream(&bytes);
    google::protobuf::io::CodedOutputStream coded(&stream);
    coded.SetSerializationDeterministic(true);  // the order of labels
    RG_CHECK(asked.SerializeToCodedStream(&coded));
  }
  return Sha256Hex(bytes);
}

}  // namespace rg::coordinator

#include "services/cli/early_warnings.h"

#include "services/cli/context.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/reporting/set_check.h"

namespace rg::cli {

Result<std::vector<std::string>> SayWarnings(const Context& context, const recordings::RecordingSet& set,
                                             const std::optional<sim::ModelFile>& model, bool trust_effort) {
  RG_ASSIGN_OR_RETURN(const sim::Plant plant, diagnosis::GivenPlant(set, model));
  RG_ASSIGN_OR_RETURN(diagnosis::SetCheck check, diagnosis::CheckSet(set, plant, trust_effort));
  RG_RETURN_IF_ERROR(check.refusal);  // alone: one line for a bad set
  if (!context.quiet()) {
    for (const std::string& warning : check.warnings) PrintNote("note: " + warning);
  }
  return std::move(check.warnings);
}

}  // namespace rg::cli

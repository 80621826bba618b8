// report.html of an identification: how much better held-out recordings are predicted, and what the
// parameters are worth: base parameters that the data determine, what only the prior says, verdict by
// verdict.
#pragma once

#include <string>

#include "services/sysid/sysid_on_set.h"

namespace rg::report {

std::string SysidPage(const sysid::SysidReport& report);

}  // namespace rg::report

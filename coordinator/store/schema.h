// The coordinator's tables. Released steps are frozen: append the next, never edit one.
#pragma once

#include "common/store/database.h"

namespace rg::coordinator {

store::Module CoordinatorSchema();

}  // namespace rg::coordinator

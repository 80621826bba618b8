// How often the calling thread has called operator new. Linking this unit replaces the operator.
#pragma once

namespace rg::robot_agent {

long AllocationsOfThisThread();

}  // namespace rg::robot_agent

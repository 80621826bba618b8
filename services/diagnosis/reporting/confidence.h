// How sure a finding is, from how such findings fared on sets with known answers.
//
// Log evidence says how much better a model fits than its rivals; it does not know of laws that are not in
// the catalogue, so beyond a few nats it is far too sure. What tells right names from wrong ones is what
// stands beside them: nothing left unexplained, few names, no rival near. The shares are hit rates on the
// sets of blind examinations (docs/proof.md) after they had been taken; `realitygrad prove` with other seeds
// measures whether they hold.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/api/result.h"

namespace rg::diagnosis {

// Replaces each finding's confidence, the odds of its evidence alone, by the smaller of it and the hit rate
// of its like; side remarks (`parameters_only` beside a name) are no surer than the names before them.
// Findings end sorted: surest first, side remarks last. `measured`: the search over a measured effort, which
// judges names by what they explain on parts left out and keeps them beside `unexplained`.
// `joints`: of the robot. On an ordinary one, with two losses of drives on most joints, what drives share is surer
// than many names are elsewhere.
void Calibrate(const std::string& verdict, bool measured, int joints, std::vector<Finding>* findings);

}  // namespace rg::diagnosis

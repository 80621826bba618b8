// The concealed recordings of a case, predicted by a model that never saw them.
#pragma once

#include <string>

#include "common/base/rng.h"
#include "common/base/status.h"
#include "services/proof/examination.h"

namespace rg::proof {

// LABELS/<case>/oracle.json and hidden_000.csv … against MODEL (a diagnosis' model.json): windows of 1 s
// restarted from the measured state, compared with the columns true_position.*. Without a model `tool` is
// NaN. A set or a model that its reader refuses is an outcome (`refused` says why, nothing is predicted);
// oracle.json and concealed recordings that are none are errors. The black box is fitted to SETS/<case>, seen
// by nobody else.
struct Concealed {
  PredictionMarks marks;
  CasePlot plot;
  std::string refused;
};
Result<Concealed> PredictConcealed(const std::string& label_folder, const std::string& set_folder,
                                   const std::string& model_file, Rng rng);

}  // namespace rg::proof

#include "services/proof/generator/fields.h"

#include <cmath>

#include "common/base/check.h"

namespace rg::proof {

std::vector<std::string> FieldForms(int n) {
  // Named more than once: drawn more often.
  std::vector<std::string> forms = {"bump", "detent", "detent", "sticky_patch", "speed_bump", "wind"};
  if (n > 1) forms.insert(forms.end(), {"bump", "bump", "wave", "saddle", "cross_speed"});
  return forms;
}

double FieldForce(const Field& f, const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time) {
  const double a = (q[f.over[0]] - f.center[0]) / f.width[0], own = v[f.on];
  const double b = (q[f.over[1]] - f.center[1]) / f.width[1];
  const double second = f.over[1] != f.over[0] ? b : 0.0;
  if (f.form == "bump") return f.amplitude * std::exp(-0.5 * (a * a + second * second));
  if (f.form == "detent") return -f.amplitude * a * std::exp(0.5 * (1 - a * a));
  if (f.form == "wave") return f.amplitude * std::sin(a) * std::cos(b);
  if (f.form == "saddle") return f.amplitude * std::tanh(a) * std::tanh(b);
  if (f.form == "sticky_patch") return -f.amplitude * own / f.speed * std::exp(-0.5 * a * a);
  if (f.form == "cross_speed") return -f.amplitude * v[f.over[1]] / f.speed * std::sin(a);
  if (f.form == "wind") return f.amplitude * std::cos(2 * M_PI * time / f.period + a);
  RG_CHECK(f.form == "speed_bump") << f.form;
  if (own * f.direction < 0) return 0.0;
  const double off = (std::abs(own) - f.speed) / f.speed_width;
  return -f.amplitude * std::tanh(10 * own / f.speed) * std::exp(-0.5 * off * off);
}

}  // namespace rg::proof

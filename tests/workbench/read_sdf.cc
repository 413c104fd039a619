// What Gazebo's own library makes of a model: numbers as JSON, or its complaints and exit 1.
#include <iostream>
#include <iterator>
#include <string>

#include <sdf/Joint.hh>
#include <sdf/JointAxis.hh>
#include <sdf/Link.hh>
#include <sdf/Model.hh>
#include <sdf/Root.hh>

int main() {
  const std::string text{std::istreambuf_iterator<char>(std::cin), {}};
  sdf::Root root;
  const auto errors = root.LoadSdfString(text);
  for (const auto &error : errors) std::cerr << error << "\n";
  if (!errors.empty()) return 1;
  const auto inertial = root.Model()->LinkByIndex(0)->Inertial();
  const auto *joint = root.Model()->JointByIndex(0);
  const auto *axis = joint->Axis();
  std::cout.precision(17);
  std::cout << "{\"mass\": " << inertial.MassMatrix().Mass() << ", \"ixx\": " << inertial.MassMatrix().Ixx()
            << ", \"y\": " << inertial.Pose().Pos().Y() << ", \"z\": " << inertial.Pose().Pos().Z()
            << ", \"axis_x\": " << axis->Xyz().X() << ", \"revolute\": " << (joint->Type() == sdf::JointType::REVOLUTE)
            << ", \"damping\": " << axis->Damping() << ", \"friction\": " << axis->Friction()
            << ", \"spring_stiffness\": " << axis->SpringStiffness()
            << ", \"spring_reference\": " << axis->SpringReference() << ", \"lower\": " << axis->Lower()
            << ", \"upper\": " << axis->Upper() << ", \"stiffness\": " << axis->Stiffness()
            << ", \"dissipation\": " << axis->Dissipation() << "}\n";
}

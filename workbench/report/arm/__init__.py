"""The report of an arm: errors joint by joint, and where each joint's torque is not the model's."""

from workbench.report.arm.page import write_arm_comparison_report, write_arm_report

__all__ = ["write_arm_comparison_report", "write_arm_report"]

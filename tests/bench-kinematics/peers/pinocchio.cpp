// Pinocchio on the arm that arrives on standard input.
#include "peer.hpp"
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>

namespace pin = pinocchio;

class Pinocchio {
  public:
    Pinocchio(const std::vector<Row>& rows, double tool_z) {
        pin::JointIndex parent = 0;
        pin::SE3 before = pin::SE3::Identity();
        for (const Row& r : rows) {
            const std::string name = "joint" + std::to_string(parent + 1);
            parent = model_.addJoint(parent, pin::JointModelRZ(), before, name);
            double s, c;
            twist(r.alpha, s, c);
            Eigen::Matrix3d turn;
            turn << 1, 0, 0, 0, c, -s, 0, s, c;
            before = pin::SE3(turn, Eigen::Vector3d(r.a, 0, r.d));
            const Eigen::Vector3d com(r.com[0], r.com[1], r.com[2]);
            const Eigen::Matrix3d inertia = Eigen::Vector3d(r.i[0], r.i[1], r.i[2]).asDiagonal();
            model_.appendBodyToJoint(parent, pin::Inertia(r.mass, com, inertia), before);
        }
        const pin::SE3 tool = before * pin::SE3(Eigen::Matrix3d::Identity(), Eigen::Vector3d(0, 0, tool_z));
        frame_ = model_.addFrame(pin::Frame("tool", parent, 0, tool, pin::OP_FRAME));
        data_ = pin::Data(model_);
        j_.setZero(6, model_.nv);
    }

    void fk(const double* q) {
        pin::forwardKinematics(model_, data_, Eigen::Map<const Eigen::VectorXd>(q, 6));
        pin::updateFramePlacement(model_, data_, frame_);
    }
    void jacobian(const double* q) {
        pin::computeFrameJacobian(model_, data_, Eigen::Map<const Eigen::VectorXd>(q, 6), frame_, pin::LOCAL, j_);
    }
    void rnea(const double* q, const double* qd, const double* qdd) {
        using V = Eigen::Map<const Eigen::VectorXd>;
        pin::rnea(model_, data_, V(q, 6), V(qd, 6), V(qdd, 6));
    }
    void print_fk() const {
        const pin::SE3& m = data_.oMf[frame_];
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) print(m.rotation()(r, c));
        for (int r = 0; r < 3; ++r) print(m.translation()(r));
    }
    void print_jacobian() const {
        for (int r = 0; r < 6; ++r)
            for (int c = 0; c < 6; ++c) print(j_(r, c));
    }
    void print_rnea() const {
        for (int i = 0; i < 6; ++i) print(data_.tau(i));
    }

  private:
    pin::Model model_;
    pin::Data data_;
    pin::FrameIndex frame_ = 0;
    pin::Data::Matrix6x j_;
};

int main() { return serve<Pinocchio>(); }

// KDL on the arm that arrives on standard input.
#include "peer.hpp"
#include <kdl/chain.hpp>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainidsolver_recursive_newton_euler.hpp>
#include <kdl/chainjnttojacsolver.hpp>
#include <memory>

class Kdl {
  public:
    Kdl(const std::vector<Row>& rows, double tool_z) : q_(6), qd_(6), qdd_(6), tau_(6), jacobian_(6), wrenches_(6) {
        for (size_t n = 0; n < rows.size(); ++n) {
            const Row& r = rows[n];
            double s, c;
            twist(r.alpha, s, c);
            const KDL::Frame behind(KDL::Rotation(1, 0, 0, 0, c, -s, 0, s, c), KDL::Vector(r.a, 0, r.d));
            const KDL::RotationalInertia inertia(r.i[0], r.i[1], r.i[2], 0, 0, 0);
            const KDL::Vector com(r.com[0], r.com[1], r.com[2]);
            const double z = n + 1 == rows.size() ? tool_z : 0.0;
            const KDL::Frame tool(KDL::Vector(0, 0, z));
            // KDL wants the body in the frame of the segment's tip.
            const KDL::RigidBodyInertia body(r.mass, com - KDL::Vector(0, 0, z), inertia);
            chain_.addSegment(KDL::Segment(KDL::Joint(KDL::Joint::RotZ), behind * tool, body));
        }
        fk_.reset(new KDL::ChainFkSolverPos_recursive(chain_));
        jac_.reset(new KDL::ChainJntToJacSolver(chain_));
        id_.reset(new KDL::ChainIdSolver_RNE(chain_, KDL::Vector(0, 0, -9.81)));
    }

    void fk(const double* q) {
        fill(q_, q);
        fk_->JntToCart(q_, pose_);
    }
    // In the base's axes: KDL has no Jacobian in the tool's, turning it there is one more call.
    void jacobian(const double* q) {
        fill(q_, q);
        jac_->JntToJac(q_, jacobian_);
        fk_->JntToCart(q_, pose_);
        jacobian_.changeBase(pose_.M.Inverse());
    }
    void rnea(const double* q, const double* qd, const double* qdd) {
        fill(q_, q), fill(qd_, qd), fill(qdd_, qdd);
        id_->CartToJnt(q_, qd_, qdd_, wrenches_, tau_);
    }
    void print_fk() const {
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) print(pose_.M(r, c));
        for (int r = 0; r < 3; ++r) print(pose_.p(r));
    }
    void print_jacobian() const {
        for (int r = 0; r < 6; ++r)
            for (int c = 0; c < 6; ++c) print(jacobian_(r, c));
    }
    void print_rnea() const {
        for (int i = 0; i < 6; ++i) print(tau_(i));
    }

  private:
    static void fill(KDL::JntArray& to, const double* from) {
        for (int i = 0; i < 6; ++i) to(i) = from[i];
    }

    KDL::Chain chain_;
    KDL::JntArray q_, qd_, qdd_, tau_;
    KDL::Jacobian jacobian_;
    KDL::Wrenches wrenches_;
    KDL::Frame pose_;
    std::unique_ptr<KDL::ChainFkSolverPos_recursive> fk_;
    std::unique_ptr<KDL::ChainJntToJacSolver> jac_;
    std::unique_ptr<KDL::ChainIdSolver_RNE> id_;
};

int main() { return serve<Kdl>(); }

// What both peers share: the arm and the samples arrive on standard input, orders follow, answers go out. A peer is a class with
//   Peer(const std::vector<Row>&, double tool_z);  void fk(const double* q);  void jacobian(const double* q);
//   void rnea(const double* q, const double* qd, const double* qdd);
//   void print_fk(); void print_jacobian(); void print_rnea();   (of the call before)
#pragma once
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

struct Row {
    double a, d, alpha;        // Denavit-Hartenberg, distal
    double mass, com[3], i[3]; // in the frame behind the row; principal moments about the centre of mass
};

struct Sample {
    double q[6], qd[6], qdd[6];
};

inline double number() {
    double x;
    if (!(std::cin >> x)) {
        std::cerr << "peer: a number was expected\n";
        std::exit(2);
    }
    return x;
}

inline void print(double x) { std::printf("%.17g ", x); }

// The twist's sine and cosine, exact for quarter turns.
inline void twist(double alpha, double& s, double& c) {
    s = alpha > 1.0 ? 1.0 : alpha < -1.0 ? -1.0 : 0.0;
    c = s == 0.0 ? 1.0 : 0.0;
}

template <class Peer> int serve() {
    std::vector<Row> rows(6);
    const double tool_z = number();
    for (Row& r : rows) {
        r.a = number(), r.d = number(), r.alpha = number(), r.mass = number();
        for (double& x : r.com) x = number();
        for (double& x : r.i) x = number();
    }
    std::vector<Sample> samples(static_cast<size_t>(number()));
    for (Sample& s : samples) {
        for (double& x : s.q) x = number();
        for (double& x : s.qd) x = number();
        for (double& x : s.qdd) x = number();
    }
    Peer peer(rows, tool_z);
    std::string order;
    while (std::cin >> order) {
        if (order == "answers") {
            for (const Sample& s : samples) {
                peer.fk(s.q), peer.print_fk();
                peer.jacobian(s.q), peer.print_jacobian();
                peer.rnea(s.q, s.qd, s.qdd), peer.print_rnea();
                std::printf("\n");
            }
        } else {
            const int rounds = static_cast<int>(number());
            const auto start = std::chrono::steady_clock::now();
            for (int n = 0; n < rounds; ++n) {
                for (const Sample& s : samples) {
                    if (order == "fk") peer.fk(s.q);
                    else if (order == "jacobian") peer.jacobian(s.q);
                    else if (order == "rnea") peer.rnea(s.q, s.qd, s.qdd);
                    else return 2;
                }
            }
            const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - start;
            std::printf("%.6f\n", took.count() / (static_cast<double>(rounds) * static_cast<double>(samples.size())));
        }
        std::fflush(stdout);
    }
    return 0;
}

// The spot's profile by Ceres with automatic derivatives, as a careful user of Ceres writes it: one residual block of all pixels,
// memory that is kept from frame to frame, weights and pixels fixed at the prediction, one thread, the last answer as the start.
// -O3 -march=native -ffast-math.
// In: a course's file (course.rs says how it is written). Out: a line for each frame and method: name, microseconds, x, y.
#include <ceres/ceres.h>
#include <ceres/tiny_solver.h>
#include <ceres/tiny_solver_autodiff_function.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <vector>

using Parameters = Eigen::Matrix<double, 7, 1>;  // bx, by, a1, a2, a3, v0, v1

struct Course {
    double count, width, height, gain, read_noise, full, k1, k2, reach;
    double start[7];
};

struct Place {
    double x, y;                       // predicted centre
    double left, top, width, height;   // window
};

struct Pixel {
    double x, y, value, weight;
};

// f(s) of the profile.
template <typename T>
T Profile(const Course& course, const T& s) {
    if (s >= 1.0) return T(0.0);
    return 1.0 + s * (course.k1 + s * (course.k2 - s * (1.0 + course.k1 + course.k2)));
}

// Residuals of the pixels by their deviations.
struct Residuals {
    enum { NUM_RESIDUALS = Eigen::Dynamic, NUM_PARAMETERS = 7 };
    const Course* course;
    const std::vector<Pixel>* pixels;

    int NumResiduals() const { return int(pixels->size()); }

    template <typename T>
    bool operator()(const T* p, T* residuals) const {
        for (const Pixel& pixel : *pixels) {
            const T dx = pixel.x - p[0], dy = pixel.y - p[1];
            const T s = p[2] * dx * dx + 2.0 * p[3] * dx * dy + p[4] * dy * dy;
            *residuals++ = pixel.weight * (p[5] + p[6] * Profile(*course, s) - pixel.value);
        }
        return true;
    }
};

// The pixels of the domain at the prediction that are not saturated, with their weights there.
void Choose(const Course& course, const Place& place, const uint8_t* frame, const Parameters& at, std::vector<Pixel>* pixels) {
    pixels->clear();
    for (int y = int(place.top); y < int(place.top + place.height); y++) {
        const uint8_t* row = frame + size_t(y) * size_t(course.width);
        for (int x = int(place.left); x < int(place.left + place.width); x++) {
            const double dx = x - at[0], dy = y - at[1];
            const double s = at[2] * dx * dx + 2 * at[3] * dx * dy + at[4] * dy * dy;
            if (s > course.reach || row[x] >= course.full) continue;
            const double mean = std::max(at[5] + at[6] * Profile(course, s), 0.0);
            const double variance = course.gain * mean + course.read_noise * course.read_noise + 1.0 / 12;
            pixels->push_back({double(x), double(y), double(row[x]), 1 / std::sqrt(variance)});
        }
    }
}

bool ByCeres(const Course& course, const std::vector<Pixel>& pixels, Parameters* p) {
    ceres::Problem::Options kept;
    kept.disable_all_safety_checks = true;
    ceres::Problem problem(kept);
    using Cost = ceres::AutoDiffCostFunction<Residuals, ceres::DYNAMIC, 7>;
    problem.AddResidualBlock(new Cost(new Residuals{&course, &pixels}, int(pixels.size())), nullptr, p->data());
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
    options.num_threads = 1;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.IsSolutionUsable();
}

using Function = ceres::TinySolverAutoDiffFunction<Residuals, Eigen::Dynamic, 7>;

bool ByTinySolver(const Course& course, const std::vector<Pixel>& pixels, Parameters* p) {
    static ceres::TinySolver<Function> solver;
    const Residuals residuals{&course, &pixels};
    solver.options.function_tolerance = 0.01;  // of chi square: steps that change it by less say nothing
    solver.Solve(Function(residuals), p);
    return solver.summary.status != ceres::TinySolver<Function>::HIT_MAX_ITERATIONS;
}

int main(int, char** arguments) {
    std::ifstream file(arguments[1], std::ios::binary);
    Course course;
    file.read(reinterpret_cast<char*>(&course), sizeof course);
    std::vector<Place> places(size_t(course.count));
    const size_t size = size_t(course.width * course.height);
    std::vector<uint8_t> frames(places.size() * size);
    for (size_t i = 0; i < places.size(); i++) {
        file.read(reinterpret_cast<char*>(&places[i]), sizeof(Place));
        file.read(reinterpret_cast<char*>(&frames[i * size]), long(size));
    }
    if (!file) return 1;
    const Parameters start = Eigen::Map<Parameters>(course.start);
    std::vector<Pixel> pixels;
    pixels.reserve(size);
    for (int method = 0; method < 2; method++) {
        Parameters last = start;
        for (size_t i = 0; i < places.size(); i++) {
            const auto begin = std::chrono::steady_clock::now();
            Parameters p = last;
            p[0] = places[i].x;
            p[1] = places[i].y;
            Choose(course, places[i], &frames[i * size], p, &pixels);
            const bool good = method ? ByTinySolver(course, pixels, &p) : ByCeres(course, pixels, &p);
            const std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - begin;
            last = good ? p : start;
            const double nothing = std::nan("");
            std::printf("%s\t%.3f\t%.6f\t%.6f\n", method ? "Ceres, TinySolver" : "Ceres", took.count(), good ? p[0] : nothing,
                        good ? p[1] : nothing);
        }
    }
}

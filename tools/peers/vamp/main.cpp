// Copyright 2026 The obb_collision developers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// Motions of VAMP's Panda among boxes, sampled at 32 states per rad: seconds and verdicts.
//
//     program FILE ROUNDS
//
// FILE: the numbers of boxes and motions (two 64-bit integers); of each box the centre, three axes
// and half extents; all starts and all ends, seven joints each (32-bit floats). Written to stdout:
// the least processor time of all motions (a 64-bit float), and a byte for each, 1 for free. A
// motion from a state to itself is one state.

#include <time.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include <vamp/collision/environment.hh>
#include <vamp/planning/validate.hh>
#include <vamp/robots/panda.hh>

using Panda = vamp::robots::Panda;
constexpr std::size_t kLanes = vamp::FloatVectorWidth;

template <typename T>
std::vector<T> read(std::FILE* file, std::size_t count) {
  std::vector<T> values(count);
  if (std::fread(values.data(), sizeof(T), count, file) != count) {
    std::fputs("the file is too short\n", stderr);
    std::exit(1);
  }
  return values;
}

double processor_time() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

std::vector<Panda::Configuration> states_of(const std::vector<float>& joints) {
  std::vector<Panda::Configuration> states;
  for (std::size_t k = 0; k < joints.size(); k += Panda::dimension) {
    std::array<float, Panda::dimension> one;
    std::copy_n(joints.begin() + k, Panda::dimension, one.begin());
    states.emplace_back(one);
  }
  return states;
}

int main(int count, char** arguments) {
  std::FILE* file = count == 3 ? std::fopen(arguments[1], "rb") : nullptr;
  if (file == nullptr) {
    std::fputs("program FILE ROUNDS\n", stderr);
    return 1;
  }
  const auto sizes = read<std::int64_t>(file, 2);
  const auto boxes = read<float>(file, 15 * sizes[0]);
  const auto starts = states_of(read<float>(file, Panda::dimension * sizes[1]));
  const auto ends = states_of(read<float>(file, Panda::dimension * sizes[1]));
  std::fclose(file);

  vamp::collision::Environment<float> world;
  for (auto b = boxes.begin(); b != boxes.end(); b += 15) {
    world.cuboids.emplace_back(b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7], b[8], b[9], b[10],
                               b[11], b[12], b[13], b[14]);
  }
  world.sort();
  const vamp::collision::Environment<vamp::FloatVector<kLanes>> lanes(world);

  std::vector<char> free(starts.size());
  double least = 1e9;
  for (int round = 0; round < std::atoi(arguments[2]); ++round) {
    const double begin = processor_time();
    for (std::size_t n = 0; n < starts.size(); ++n) {
      free[n] = vamp::planning::validate_motion<Panda, kLanes, Panda::resolution>(
          starts[n], ends[n], lanes);
    }
    least = std::min(least, processor_time() - begin);
  }
  std::fwrite(&least, sizeof(least), 1, stdout);
  std::fwrite(free.data(), 1, free.size(), stdout);
  return 0;
}

// Writes the fuzzers' first inputs, one folder per target, beside the files that are there: fuzz_seeds FOLDER
#include <filesystem>
#include <fstream>

#include "iotcloud/tests/fuzz/seeds.h"

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  for (const auto& [target, seeds] : iotcloud::fuzz::all_seeds()) {
    const std::filesystem::path folder = std::filesystem::path(argv[1]) / target;
    std::filesystem::create_directories(folder);
    for (const auto& [name, bytes] : seeds) std::ofstream(folder / name, std::ios::binary) << bytes;
  }
}

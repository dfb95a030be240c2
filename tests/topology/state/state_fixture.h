#pragma once

#include <exception>
#include <functional>
#include <string>

#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::topology::workshop {

/// A folder for stores of state.
class Folder : public tests::TemporaryFolder {
 public:
  std::string url(const std::string& name = "db") const { return "rocksdb://" + path() + "/" + name; }
};

/// The message of what `call` throws; empty if it throws nothing.
inline std::string problem_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const std::exception& e) {
    return e.what();
  }
  return "";
}

}  // namespace iotcloud::topology::workshop

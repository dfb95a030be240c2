#pragma once

#include <sys/fsuid.h>
#include <unistd.h>

namespace iotcloud::rpc::test {

/// Sockets that this thread makes meanwhile belong to another user of the machine. It takes root.
class AsNobody {
 public:
  AsNobody() { setfsuid(nobody); }
  ~AsNobody() { setfsuid(geteuid()); }
  AsNobody(const AsNobody&) = delete;
  AsNobody& operator=(const AsNobody&) = delete;

 private:
  static constexpr uid_t nobody = 65534;
};

}  // namespace iotcloud::rpc::test

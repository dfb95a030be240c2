// How libraries in a driver host connect and ask for names, when a connector does it for the host
// (processes/connector.h). The program's own functions come before those of the C library for all shared libraries,
// plugins too. What gets around them, a system call of its own say, is refused by the filter.
#include <dlfcn.h>
#include <netdb.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <iotcloud/processes/connector.h>

#define SEEN_BY_LIBRARIES extern "C" __attribute__((visibility("default"), used))

SEEN_BY_LIBRARIES int connect(int socket, const sockaddr* address, socklen_t size) {
  if (iotcloud::processes::has_connector()) return iotcloud::processes::connect_through(socket, address, size);
  return static_cast<int>(syscall(SYS_connect, socket, address, size));
}

SEEN_BY_LIBRARIES int getaddrinfo(const char* node, const char* service, const addrinfo* hints, addrinfo** found) {
  static const auto real = reinterpret_cast<decltype(&::getaddrinfo)>(dlsym(RTLD_NEXT, "getaddrinfo"));
  if (iotcloud::processes::has_connector()) return iotcloud::processes::find_through(real, node, service, hints, found);
  return real(node, service, hints, found);
}

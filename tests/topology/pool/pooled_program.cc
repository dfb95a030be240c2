// A worker that does what its YAML says, in one word; started by worker_processes_test.cc.
#include <csignal>
#include <cstdlib>
#include <string>

#include <unistd.h>

#include <iotcloud/processes/durable_file.h>
#include <iotcloud/topology/pool/pooled_worker.h>

int main(int, char** argv) {
  using namespace iotcloud;
  const std::string folder = argv[2];
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &ending, nullptr);
  topology::PooledWorker link(folder);
  const std::string wanted = processes::read_file(folder + "/" + topology::pooled::yaml_name, 0);
  if (wanted == "refuse" || wanted == "fail") {
    link.leave_word(wanted == "refuse", "there is no class");
    return 1;
  }
  if (wanted == "crash") std::abort();
  link.show({true, "worker-" + std::to_string(getpid())});
  if (wanted == "stand still") raise(SIGSTOP);
  int received = 0;
  sigwait(&ending, &received);
  if (wanted == "stay") pause();
  return 0;
}

#include <iotcloud/discovery/client/batch.h>

namespace iotcloud::discovery {

std::shared_ptr<Batch> Batch::start(RegistryConnection& connection, std::span<const std::string> paths,
                                    const Read& read, Done done) {
  std::shared_ptr<Batch> batch(new Batch(paths.size(), std::move(done)));
  for (std::size_t place = 0; place < paths.size(); ++place) {
    read(connection, paths[place], [batch, place](Reply reply) { batch->answered(place, std::move(reply)); });
  }
  return batch;
}

void Batch::answered(std::size_t place, Reply reply) {
  Reply all;
  {
    const config::MutexLock lock(mutex_);
    away_ = away_ || reply.status == ReplyStatus::away;
    replies_[place] = std::move(reply);
    if (--missing_ > 0) return;
    all.status = away_ ? ReplyStatus::away : ReplyStatus::ok;
  }
  done_(std::move(all));
}

}  // namespace iotcloud::discovery

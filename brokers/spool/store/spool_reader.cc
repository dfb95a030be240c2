#include "iotcloud/brokers/spool/store/spool_reader.h"

#include <utility>

namespace iotcloud::brokers::spool {

void SpoolReader::open(std::shared_ptr<Segment> segment, std::uint64_t offset) {
  close();
  if (segment) current_.emplace(std::move(segment), offset);
}

void SpoolReader::close() {
  if (current_) damaged_ += current_->skipped();
  current_.reset();
}

void SpoolReader::seek(const Position& position) {
  auto segment = store_.segment_at(position.segment);
  const bool there = segment && segment->first() == position.segment;
  open(std::move(segment), there ? position.offset : 0);
}

std::optional<Record> SpoolReader::next() {
  if (!current_) open(store_.segment_at(0), 0);
  while (current_) {
    // Asks before it reads: if there is a following segment now, this one gets no more records, so its end is its end.
    auto following = store_.segment_after(current_->segment()->first());
    if (auto record = current_->next()) return record;
    if (!following) return std::nullopt;
    if (current_->bad_tail() > 0) {
      damaged_ += current_->bad_tail();
      current_->segment()->note_damage();
    }
    open(std::move(following), 0);
  }
  return std::nullopt;
}

std::uint64_t SpoolReader::take_damaged_bytes() {
  const std::uint64_t all = damaged_ + (current_ ? current_->skipped() : 0);
  return all - std::exchange(taken_, all);
}

}  // namespace iotcloud::brokers::spool

package iotcloud.storm;

import java.util.Arrays;
import java.util.HashSet;
import java.util.Set;
import org.apache.storm.tuple.Tuple;

/** The tuples that a bolt of C++ has not answered yet, by the numbers under which it knows them. */
final class Slots {
  private Tuple[] tuples = new Tuple[64];
  private int[] free = new int[64];
  private int freeCount;
  private final Set<Integer> failed = new HashSet<>();

  Slots() {
    addFree(0);
  }

  private void addFree(int from) {
    for (int slot = tuples.length - 1; slot >= from; slot--) {
      free[freeCount++] = slot;
    }
  }

  int put(Tuple tuple) {
    if (freeCount == 0) {
      int before = tuples.length;
      tuples = Arrays.copyOf(tuples, 2 * before);
      free = new int[2 * before];
      addFree(before);
    }
    int slot = free[--freeCount];
    tuples[slot] = tuple;
    return slot;
  }

  Tuple get(int slot) {
    return tuples[slot];
  }

  /** Notes that Storm was told that the tuple failed, before C++ answers it. Returns false when that is known. */
  boolean noteFailed(int slot) {
    return failed.add(slot);
  }

  boolean hasFailed(int slot) {
    return !failed.isEmpty() && failed.contains(slot);
  }

  Tuple take(int slot) {
    Tuple tuple = tuples[slot];
    if (!failed.isEmpty()) {
      failed.remove(slot);
    }
    tuples[slot] = null;
    free[freeCount++] = slot;
    return tuple;
  }
}

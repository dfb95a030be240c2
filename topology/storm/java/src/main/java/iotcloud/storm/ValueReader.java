package iotcloud.storm;

import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.util.ArrayDeque;
import java.util.Queue;

/** Reads values that C++ wrote, as topology/storm/value_format.h describes them. One call at a time. */
final class ValueReader {
  /** A value of a tuple that C++ has not answered yet. */
  interface Kept {
    Object value(int slot, int place);
  }

  private final Kept kept;
  private final Queue<byte[]> arrays = new ArrayDeque<>();
  private byte[] scratch = new byte[64];

  ValueReader(Kept kept) {
    this.kept = kept;
  }

  /** Adds a value that is not among the bytes. */
  void addArray(byte[] array) {
    arrays.add(array);
  }

  Object value(ByteBuffer from) {
    switch (from.get()) {
      case ValueKind.NULL:
        return null;
      case ValueKind.NO:
        return Boolean.FALSE;
      case ValueKind.YES:
        return Boolean.TRUE;
      case ValueKind.INTEGER:
        return from.getLong();
      case ValueKind.REAL:
        return from.getDouble();
      case ValueKind.STRING:
        return text(from);
      case ValueKind.OF_TUPLE:
        return kept.value(from.getInt(), from.getInt());
      case ValueKind.ARRAY:
        return arrays.remove();
      case ValueKind.PAYLOAD:
        return bytes(from);
      default:
        throw new IllegalStateException("C++ and Java of this jar are of different builds: they have other kinds of values");
    }
  }

  /** A count, and as many bytes of UTF-8. */
  String text(ByteBuffer from) {
    int size = from.getInt();
    if (size > scratch.length) {
      scratch = new byte[size];
    }
    from.get(scratch, 0, size);
    return new String(scratch, 0, size, StandardCharsets.UTF_8);
  }

  private static byte[] bytes(ByteBuffer from) {
    byte[] bytes = new byte[from.getInt()];
    from.get(bytes);
    return bytes;
  }
}

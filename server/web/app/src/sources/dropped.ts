// What is dropped on the page: files, or those of a folder.

/** So many of a folder's at most. */
const FILES_MAX = 500;

export async function filesOf(dropped: DataTransfer): Promise<File[]> {
  const entries = [...dropped.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const plain = [...dropped.files]; // read at once: what was dropped is gone after the first wait
  if (!entries.some((entry) => entry.isDirectory)) return plain;
  const found: File[] = [];
  for (const entry of entries) {
    if (entry.isFile) found.push(await fileOf(entry as FileSystemFileEntry));
    else found.push(...await filesIn(entry as FileSystemDirectoryEntry));
  }
  return found.slice(0, FILES_MAX);
}

function fileOf(entry: FileSystemFileEntry): Promise<File> {
  return new Promise((done, failed) => entry.file(done, failed));
}

async function filesIn(folder: FileSystemDirectoryEntry): Promise<File[]> {
  const reader = folder.createReader();
  const found: File[] = [];
  while (found.length < FILES_MAX) {
    const some = await new Promise<FileSystemEntry[]>((done, failed) => reader.readEntries(done, failed));
    if (some.length === 0) break;
    for (const entry of some) if (entry.isFile) found.push(await fileOf(entry as FileSystemFileEntry));
  }
  return found;
}
